"""Detection of settings that have no effect at any point of a grid."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from splits.core.validation import format_key, invalid
from splits.experiments.config.medium import MERGED_KEYWORDS
from splits.experiments.config.simulation import SAMPLE_KEY, SimulationConfig
from splits.media import ParticleLayer
from splits.media.kinds import LAYERS_KEY
from splits.media.measured_inputs import REPLACED_FIELDS
from splits.tables.axes import INCIDENCE

UNUSED_KEYWORDS: tuple[tuple[tuple[str, ...], Callable[[ParticleLayer], bool], str], ...] = (
    (
        ("optical_thickness", "single_scattering_albedo", "asymmetry", "phase_function",
         "max_polarization", "bottom_albedo"),
        lambda layer: layer.opaque,
        "an opaque surface transmits no light",
    ),
    (
        ("bottom_albedo",),
        lambda layer: layer.optical_thickness == math.inf,
        "no light reaches the bottom of an infinite layer",
    ),
    (
        ("asymmetry",),
        lambda layer: layer.phase_function != "henyey_greenstein",
        "it is a parameter of henyey_greenstein",
    ),
    (
        ("max_polarization",),
        lambda layer: not layer.polarized,
        "it has an effect with polarized: true only",
    ),
    (
        ("max_polarization",),
        lambda layer: layer.phase_function == "rayleigh",
        "it is fixed for Rayleigh scattering",
    ),
)  # fmt: skip
"""Keywords, the condition in which they have no effect, and the reason."""


def collect_keywords(content: Mapping[str, Any]) -> dict[str, tuple[str, Any]]:
    """Return the keywords of the medium that an experiment file gives: their keys and values.

    Keywords of a base medium are not included, since its file serves other experiments as well.
    """
    keywords: dict[str, tuple[str, Any]] = {}
    grid = content.get("grid")
    grid = grid if isinstance(grid, Mapping) else {}
    samples = grid.get(SAMPLE_KEY)
    sections = {"medium": content.get("medium"), "grid": grid}
    if isinstance(samples, Mapping):
        sections |= {f"grid.{SAMPLE_KEY}.{label}": settings for label, settings in samples.items()}
    for prefix, settings in sections.items():
        for key, value in settings.items() if isinstance(settings, Mapping) else ():
            keywords[key] = f"{prefix}.{key}", value
    return keywords


def check_replaced_settings(content: Mapping[str, Any]) -> None:
    """Reject settings that the grid replaces at every point.

    Raises
    ------
    ValueError
        The message names the key of the setting.
    """
    grid = content.get("grid")
    grid = grid if isinstance(grid, Mapping) else {}
    replacements = {REPLACED_FIELDS.get(str(key), str(key)): key for key in grid}
    samples, instrument = grid.get(SAMPLE_KEY), content.get("instrument")
    sections = {"medium": content.get("medium")}
    if isinstance(samples, Mapping):
        sections |= {
            f"grid.{SAMPLE_KEY}.{format_key(label)}": settings
            for label, settings in samples.items()
        }
    if isinstance(instrument, Mapping) and INCIDENCE in instrument:
        sections["instrument"] = {INCIDENCE: instrument[INCIDENCE]}
    for prefix, section in sections.items():
        for key, value in section.items() if isinstance(section, Mapping) else ():
            parameter = replacements.get(REPLACED_FIELDS.get(str(key), str(key)))
            # Layers are given completely while a grid varies some settings; mappings are merged.
            if parameter is not None and key not in (*MERGED_KEYWORDS, LAYERS_KEY, SAMPLE_KEY):
                raise invalid(
                    f"{prefix}.{key}", value, "left out", f"grid.{parameter} has its values"
                )


def check_unused_keywords(
    experiment: SimulationConfig, given: Mapping[str, tuple[str, Any]]
) -> None:
    """Reject keywords of `collect_keywords` that have no effect at any point of the grid.

    Raises
    ------
    ValueError
        The message names the key of the keyword and the reason.
    """
    if experiment.medium.get("kind") != "particle_layer":
        return
    layers: list[Any] = [medium for _, medium, _ in experiment.iter_points()]
    for keys, has_no_effect, reason in UNUSED_KEYWORDS:
        for key in keys:
            prefix, value = given.get(key, ("", None))
            if value is not None and all(has_no_effect(layer) for layer in layers):
                raise invalid(prefix, value, "left out", reason)
