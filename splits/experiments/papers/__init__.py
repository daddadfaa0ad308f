"""Comparison with the numbers, trends and interpretations of the published papers."""
