"""Randomly rough surfaces: realisations, and where rays meet them."""
