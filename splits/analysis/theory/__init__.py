"""Radiative transfer theory beside the simulations."""
