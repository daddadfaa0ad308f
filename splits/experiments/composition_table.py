"""Compositions of all sands that experiments use, for the report."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from splits.experiments.simulation import Simulation
from splits.media import Sand
from splits.media.composition import Composition


def composition_table(experiments: Mapping[str, Simulation]) -> pd.DataFrame:
    """Return every intermediate of SPLITS section 4.2.5, a row per particle type and sand.

    Parameters
    ----------
    experiments : mapping
        By name.  Points of a grid that share a composition appear once per experiment.

    Returns
    -------
    pandas.DataFrame
        Columns experiment, sample, iron_oxide, hematite_ratio, magnetite, density_kg_m3 of all
        particles, and those of `splits.media.composition.Composition.rows`.
    """
    rows: list[dict[str, object]] = []
    for name, experiment in experiments.items():
        seen: list[Composition] = []
        for labels, medium, _ in experiment.iter_points():
            if not isinstance(medium, Sand) or medium.composition in seen:
                continue
            seen.append(medium.composition)
            sample = {
                "experiment": name,
                "sample": " · ".join(f"{p} {label}" for p, label in labels.items()),
                "iron_oxide": medium.iron_oxide,
                "hematite_ratio": medium.hematite_ratio,
                "magnetite": medium.magnetite,
                "sand_density_kg_m3": medium.density_kg_m3,
            }
            rows += [sample | row for row in medium.composition.to_rows()]
    return pd.DataFrame(rows)
