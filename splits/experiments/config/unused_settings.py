"""Detection of settings that have no effect at any point of a grid."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from splits.core.validation import format_key, invalid
from splits.experiments.config.medium import MERGED_KEYWORDS, SAMPLE_KEY
from splits.experiments.config.simulation import SimulationConfig
from splits.media import ParticleLayer
from splits.media.kinds import LAYERS_KEY
from splits.media.natural_snow import REPLACED_FIELDS
from splits.tables.axes import INCIDENCE

UNUSED_KEYWORDS: tuple[tuple[tuple[str, ...], Callable[[ParticleLayer], bool], str], ...] = (
    (("optical_thickness", "single_scattering_albedo", "asymmetry", "phase_function",
      "scattering_matrix", "depolarization", "bottom_albedo"),
     lambda layer: layer.opaque, "an opaque surface transmits no light"),
    (("bottom_albedo",), lambda layer: layer.optical_thickness == math.inf,
     "no light reaches the bottom of an infinite layer"),
    (("phase_function", "asymmetry", "depolarization"),
     lambda layer: layer.scattering_matrix is not None, "the scattering_matrix replaces it"),
    (("asymmetry",), lambda layer: layer.phase_function != "henyey_greenstein",
     "it is a parameter of henyey_greenstein"),
    (("depolarization",), lambda layer: layer.phase_function != "rayleigh",
     "it is a parameter of rayleigh"),
)  # fmt: skip
"""Keywords, the condition in which they have no effect, and the reason."""


def iter_settings(content: Mapping[str, Any]) -> Iterator[tuple[str, str, Any]]:
    """Yield section, key and value of the settings of media and grid in an experiment file.

    Keywords of a base medium are not included, since its file serves other experiments as well.
    """
    grid = content.get("grid")
    samples = grid.get(SAMPLE_KEY) if isinstance(grid, Mapping) else None
    sections = {"medium": content.get("medium"), "grid": grid}
    for label, settings in samples.items() if isinstance(samples, Mapping) else ():
        sections[f"grid.{SAMPLE_KEY}.{format_key(label)}"] = settings
    for section, settings in sections.items():
        for key, value in settings.items() if isinstance(settings, Mapping) else ():
            yield section, str(key), value


def check_replaced_settings(content: Mapping[str, Any]) -> None:
    """Reject settings that the grid replaces at every point; the error names their key."""
    settings, instrument = list(iter_settings(content)), content.get("instrument")
    replacements = {
        REPLACED_FIELDS.get(key, key): key for section, key, _ in settings if section == "grid"
    }
    if isinstance(instrument, Mapping) and INCIDENCE in instrument:
        settings.append(("instrument", INCIDENCE, instrument[INCIDENCE]))
    for section, key, value in settings:
        parameter = replacements.get(REPLACED_FIELDS.get(key, key))
        # Layers are given completely while a grid varies some settings; mappings are merged.
        is_merged = key in (*MERGED_KEYWORDS, LAYERS_KEY, SAMPLE_KEY)
        if section != "grid" and parameter is not None and not is_merged:
            raise invalid(f"{section}.{key}", value, "left out", f"grid.{parameter} has its values")


def check_unused_keywords(experiment: SimulationConfig, content: Mapping[str, Any]) -> None:
    """Reject keywords of a file's medium that have no effect at any point of the grid.

    The error names the key of the keyword and the reason.
    """
    if experiment.medium.get("kind") != "particle_layer":
        return
    given = {key: (f"{section}.{key}", value) for section, key, value in iter_settings(content)}
    layers: list[Any] = [medium for _, medium, _ in experiment.iter_points()]
    for keys, has_no_effect, reason in UNUSED_KEYWORDS:
        for key in keys:
            path, value = given.get(key, ("", None))
            if value is not None and all(has_no_effect(layer) for layer in layers):
                raise invalid(path, value, "left out", reason)
