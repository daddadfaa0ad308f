"""Settings of layers that would change nothing anywhere on a grid."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from splits.core.validation import format_key, invalid
from splits.experiments.config.medium import LAYERS_KEY, MERGED_KEYWORDS
from splits.experiments.config.simulation import SAMPLE_KEY, SimulationConfig
from splits.media import ParticleLayer
from splits.media.measured_inputs import REPLACED_FIELDS
from splits.tables.axes import INCIDENCE

UNUSED_KEYWORDS: tuple[tuple[tuple[str, ...], Callable[[ParticleLayer], bool], str], ...] = (
    (
        ("optical_thickness", "single_scattering_albedo", "asymmetry", "phase_function",
         "max_polarization", "bottom_albedo"),
        lambda layer: layer.opaque,
        "nothing comes back from below an opaque surface",
    ),
    (
        ("bottom_albedo",),
        lambda layer: layer.optical_thickness == math.inf,
        "no light reaches the bottom of an infinite layer",
    ),
    (
        ("asymmetry",),
        lambda layer: layer.phase_function != "henyey_greenstein",
        "it belongs to henyey_greenstein",
    ),
    (
        ("max_polarization",),
        lambda layer: not layer.polarized,
        "it counts with polarized: true",
    ),
    (
        ("max_polarization",),
        lambda layer: layer.phase_function == "rayleigh",
        "Rayleigh scattering has its own",
    ),
)  # fmt: skip
"""Keywords, where they do not count, and why."""


def collect_keywords(content: Mapping[str, Any]) -> dict[str, tuple[str, Any]]:
    """Return where an experiment file itself gives keywords of a medium, and their values.

    What the file of a base medium says is not among them: it serves other experiments, too.
    """
    found: dict[str, tuple[str, Any]] = {}
    grid = content.get("grid")
    grid = grid if isinstance(grid, Mapping) else {}
    samples = grid.get(SAMPLE_KEY)
    places = {"medium": content.get("medium"), "grid": grid}
    if isinstance(samples, Mapping):
        places |= {f"grid.{SAMPLE_KEY}.{label}": given for label, given in samples.items()}
    for place, given in places.items():
        for key, value in given.items() if isinstance(given, Mapping) else ():
            found[key] = f"{place}.{key}", value
    return found


def check_replaced_settings(content: Mapping[str, Any]) -> None:
    """Refuse settings that an experiment file gives and its grid replaces at every point.

    Raises
    ------
    ValueError
        The message says where the setting stands.
    """
    grid = content.get("grid")
    grid = grid if isinstance(grid, Mapping) else {}
    taken = {REPLACED_FIELDS.get(str(key), str(key)): key for key in grid}
    samples, beam = grid.get(SAMPLE_KEY), content.get("instrument")
    places = {"medium": content.get("medium")}
    if isinstance(samples, Mapping):
        places |= {f"grid.{SAMPLE_KEY}.{format_key(label)}": one for label, one in samples.items()}
    if isinstance(beam, Mapping) and INCIDENCE in beam:
        places["instrument"] = {INCIDENCE: beam[INCIDENCE]}
    for place, given in places.items():
        for key, value in given.items() if isinstance(given, Mapping) else ():
            by = taken.get(REPLACED_FIELDS.get(str(key), str(key)))
            # Layers are told whole, of which a grid varies some settings; mappings are merged.
            if by is not None and key not in (*MERGED_KEYWORDS, LAYERS_KEY, SAMPLE_KEY):
                raise invalid(f"{place}.{key}", value, "left out", f"grid.{by} has its values")


def check_unused_keywords(
    experiment: SimulationConfig, given: Mapping[str, tuple[str, Any]]
) -> None:
    """Refuse keywords given, see `collect_keywords`, that count at no point of the grid.

    Raises
    ------
    ValueError
        The message says where the keyword stands and why it does not count.
    """
    if experiment.medium.get("kind") != "particle_layer":
        return
    layers = [
        medium for _, medium, _ in experiment.iter_points() if isinstance(medium, ParticleLayer)
    ]
    for keys, idle, why in UNUSED_KEYWORDS:
        for key in keys:
            place, value = given.get(key, ("", None))
            if value is not None and all(idle(layer) for layer in layers):
                raise invalid(place, value, "left out", why)
