"""Layers of grains: shape and surface of grains, free flights, and the scalar kernel."""
