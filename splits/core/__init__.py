"""Common services: validation, provenance, uncertainty, progress and atomic file writes."""
