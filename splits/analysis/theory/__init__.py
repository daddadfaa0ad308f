"""Radiative transfer theories for comparison with simulations."""
