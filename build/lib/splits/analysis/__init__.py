"""What datasets say: sensitivity, agreement with measurements and published numbers."""
