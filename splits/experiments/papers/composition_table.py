"""Table of the compositions of sands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from splits.experiments.config.simulation import SimulationConfig
from splits.media.sand_composition import SandComposition


def make_composition_table(experiments: Mapping[str, SimulationConfig]) -> pd.DataFrame:
    """Return the intermediate quantities of SPLITS section 4.2.5, a row per particle type and sand.

    Parameters
    ----------
    experiments : mapping
        By name.  Points of a grid with equal compositions appear once per experiment.

    Returns
    -------
    pandas.DataFrame
        Columns experiment, sample, iron_oxide, hematite_ratio, magnetite, sand_density_kg_m3, and
        those of `splits.media.sand_composition.SandComposition.to_rows`.
    """
    rows: list[dict[str, object]] = []
    for name, experiment in experiments.items():
        seen: list[SandComposition] = []
        medium: Any
        for labels, medium, _ in experiment.iter_points():
            composition = getattr(medium, "composition", None)
            if composition is None or composition in seen:
                continue
            seen.append(composition)
            sample = {
                "experiment": name,
                "sample": " · ".join(f"{p} {label}" for p, label in labels.items()),
                "iron_oxide": medium.iron_oxide,
                "hematite_ratio": medium.hematite_ratio,
                "magnetite": medium.magnetite,
                "sand_density_kg_m3": medium.density_kg_m3,
            }
            rows += [sample | row for row in composition.to_rows()]
    return pd.DataFrame(rows)
