"""Sampling rules: options of the kernels as integer codes, and the names of the codes."""

from __future__ import annotations

from typing import NamedTuple

UNIFORM_ENTRY = 0
"""Entry point uniform over the surface facing the ray (SPLITS 4.3.3, SPLITSnow 3.2)."""
PROJECTED_ENTRY = 1
"""Entry point and orientation weighted by area projected along the ray, the geometric law."""

PROJECTED_FACETS = 0
"""Facets facing the ray, sampled in proportion to their projected area (SPLITS 4.3.4)."""
UNWEIGHTED_FACETS = 1
"""Facets facing the ray, sampled with equal probability."""
ANY_FACETS = 2
"""Any facet; one that faces away acts with its back side."""

WRONG_SIDE_LOBE = 0
"""A direction on the wrong side of the macroscopic surface is replaced by a cosine lobe."""
WRONG_SIDE_MIRROR = 1
"""A direction on the wrong side of the macroscopic surface is mirrored in that surface."""

OVERLAP_KEEP = 0
"""An overlapping grain is accepted."""
OVERLAP_REJECT = 1
"""An overlapping grain is rejected; distance and grain are sampled again from the segment start."""
OVERLAP_SKIP = 2
"""An overlapping grain is skipped: the next distance starts from it."""

GRAIN_EXTENT = {"finite": False, "point": True}
"""Whether the path through a grain displaces the ray, or the grain is a point scatterer."""

ENTRY_SAMPLING = {"uniform": UNIFORM_ENTRY, "projected": PROJECTED_ENTRY}
FACET_SAMPLING = {
    "projected": PROJECTED_FACETS,
    "unweighted": UNWEIGHTED_FACETS,
    "any": ANY_FACETS,
}
WRONG_SIDE_RULE = {"cosine_lobe": WRONG_SIDE_LOBE, "mirror": WRONG_SIDE_MIRROR}
OVERLAP_RULE = {"reject": OVERLAP_REJECT, "keep": OVERLAP_KEEP, "skip": OVERLAP_SKIP}


class SamplingRules(NamedTuple):
    """Sampling options of the kernels, as integer codes; they implement the interpretations.

    With `analog`, absorption is sampled on each segment; otherwise path lengths are recorded and
    converted to weights at the exit.  Without `boundary_fresnel`, wet pores at boundaries refract
    and reflect nothing.  With `point_grains`, grains are point scatterers: a ray leaves a grain at
    the point at which it entered.
    """

    entry_sampling: int
    facet_sampling: int
    wrong_side: int
    boundary_fresnel: bool
    segment_overlap: int
    boundary_overlap: int
    analog: bool
    point_grains: bool
