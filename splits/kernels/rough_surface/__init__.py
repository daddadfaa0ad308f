"""Randomly rough surfaces: realizations and ray intersections."""
