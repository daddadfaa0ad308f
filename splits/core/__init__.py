"""Validation, provenance, uncertainty, progress and files: what every other package uses."""
