"""Histories of rays in layers of grains and of particles: the scalar kernel."""
