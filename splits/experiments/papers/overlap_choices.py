"""Choices for grains that overlap, which rankings of interpretations combine."""

OVERLAPS_KEY = "overlaps"
"""Key of a ranking of interpretations that sets `OVERLAP_KEYS` together."""
OVERLAP_KEYS = ("overlap_with_previous_segment", "overlap_with_boundary")
"""Fields of `splits.Interpretation` for grains that overlap the last segment or a boundary."""
OVERLAP_CHOICES = {
    "reject": ("reject", "reject"),
    "keep": ("keep", "keep"),
    "skip": ("skip", "skip"),
    "segment overlap kept": ("keep", "reject"),
}
"""Values of `OVERLAPS_KEY`, and those of `OVERLAP_KEYS` for each."""
