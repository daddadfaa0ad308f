"""Retrieval of medium parameters from measured spectra by optimal estimation and least squares."""
