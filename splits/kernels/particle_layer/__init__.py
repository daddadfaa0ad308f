"""Layers of small particles, under smooth and rough surfaces, and what detectors are told."""
