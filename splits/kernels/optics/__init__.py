"""Optics of interfaces and single particles, with and without polarization, and light sources."""
