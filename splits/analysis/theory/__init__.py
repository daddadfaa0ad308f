"""Theories for comparison with simulations; Mie scattering, phase functions, shapes of grains."""
