"""Layers of grains: a grain's shape and surface, flights between grains, the scalar kernel."""
