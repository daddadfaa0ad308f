"""Look-up tables: spectra over a grid of parameters, from as few paths as serve them all."""
