"""Look-up tables: spectra over a grid of parameters, with path reuse between its points."""
