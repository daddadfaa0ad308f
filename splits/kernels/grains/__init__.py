"""Grains: shape and surface of grains, free paths, and paths through a grain."""
