"""Checks of media that users give to instruments."""

from __future__ import annotations

import math
import re
from typing import Any

from splits.core.validation import invalid, suggest_name
from splits.media.medium import GranularMedium, Medium
from splits.media.particle_layer import ParticleLayer
from splits.media.snow_packs import SnowPacks

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
    medium: Any, kind: type[Any] = Medium, *, allow_semi_infinite: bool = False
) -> None:
    """Check that a medium is of an allowed class, by default of any.

    Parameters
    ----------
    medium : object
    kind : type
        A key of `MEDIUM_NAMES`.
    allow_semi_infinite : bool
        Whether infinite layers of grains are allowed; those of particles always are.
    """
    is_class = isinstance(medium, type)
    if isinstance(medium, kind) and not is_class:
        check_thickness(medium)
        is_traceable = not (medium.is_semi_infinite and medium.lowest_layer.has_grains)
        if not (is_traceable or allow_semi_infinite):
            raise invalid("depth_m", math.inf, "finite", INFINITE_DEPTH_HINT)
        return
    names = MEDIUM_NAMES[kind]
    if isinstance(medium, SnowPacks) and kind is Medium:
        hint = "packs.make_stack(label) returns one of the snowpacks"
        raise invalid("medium", medium, "one medium", hint)
    kind_name = medium if is_class else getattr(medium, "kind", medium)
    suggestion = suggest_name(medium.__name__ if is_class else str(kind_name).capitalize(), names)
    hint = re.sub(r"mean (\w+)", r"mean splits.\1()", suggestion)
    allowed = " or ".join(f"splits.{name}(...)" for name in names)
    raise invalid("medium", kind_name, allowed, hint)


def check_thickness(medium: Any) -> None:
    """Check that a medium is thicker than its largest grain."""
    largest = medium.largest_grain_m
    if medium.depth_m <= largest:
        hint = "such a grain must fit between the boundaries"
        raise invalid(
            "depth_m", medium.depth_m, f"more than the largest grain, {largest:g} m", hint
        )
