"""Checks of media that users give to instruments."""

from __future__ import annotations

import math
from typing import Any

from splits.core.validation import format_limit, invalid
from splits.media.medium import GranularMedium, Medium
from splits.media.particle_layer import ParticleLayer
from splits.media.snow_packs import SnowPacks
from splits.media.suggestions import suggest_medium

MEDIUM_NAMES: dict[type, tuple[str, ...]] = {
    Medium: ("Snow", "Sand", "Stack", "ParticleLayer"),
    GranularMedium: ("Snow", "Sand"),
    ParticleLayer: ("ParticleLayer",),
}
"""Names of the media of each class, for messages."""
INFINITE_DEPTH_HINT = (
    "give depth_m; infinite depth is for estimator spectral, albedos, profiles and delays, and "
    "with solver discrete_ordinates (natural snow, point grains) for BRDFs and HDRFs"
)
"""Where a semi-infinite medium is allowed."""


def check_medium(
    medium: Any, kind: type[Any] = Medium, *, allow_semi_infinite: bool = False,
    key: str = "medium",
) -> None:  # fmt: skip
    """Check that a medium is of an allowed class, by default of any.

    Parameters
    ----------
    medium : object
    kind : type
        A key of `MEDIUM_NAMES`.
    allow_semi_infinite : bool
        Whether infinite layers of grains are allowed; those of particles always are.
    key : str
        Key in error messages.
    """
    if isinstance(medium, kind):
        check_thickness(medium)
        is_traceable = not (medium.is_semi_infinite and medium.lowest_layer.has_grains)
        if not (is_traceable or allow_semi_infinite):
            raise invalid("depth_m", math.inf, "finite", INFINITE_DEPTH_HINT)
        return
    names = MEDIUM_NAMES[kind]
    if isinstance(medium, SnowPacks):
        hint = "packs.make_stack(label) returns one of the snowpacks"
        hint += "" if kind is Medium else ", and its layers are media"
        raise invalid(key, medium, "one medium", hint)
    kind_name = medium if callable(medium) else getattr(medium, "kind", medium)
    allowed = " or ".join(f"splits.{name}(...)" for name in names)
    raise invalid(key, kind_name, allowed, suggest_medium(medium, names))


def check_thickness(medium: Any) -> None:
    """Check that a medium is thicker than its largest grain."""
    largest = medium.largest_grain_m
    if medium.depth_m <= largest:
        hint = "such a grain must fit between the boundaries"
        limit = format_limit(largest, medium.depth_m)
        raise invalid("depth_m", medium.depth_m, f"more than the largest grain, {limit} m", hint)
