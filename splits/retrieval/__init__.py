"""From spectra back to what made them: optimal estimation with errors."""
