"""Tables of a ranking of interpretations, see `interpretation_ranking`."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from splits.experiments.papers.interpretation_ranking import (
    BestMatch,
    RankedCombination,
    find_choice,
)
from splits.experiments.papers.interpretation_runs import WATER_TABLES
from splits.experiments.papers.misfit import PublishedStatement

STATEMENT_GROUPS = {
    "Table 3": ("table3",),
    "transmittance": ("transmittance",),
    "sensitivities, stated ranges": ("msi_r_grain", "msi_t_grain", "msi_r_facet", "msi_t_facet"),
    "sensitivities, free ranges": ("msi_r_sat", "msi_t_sat", "msi_r_dens", "msi_t_dens"),
    "angles": ("fig",),
}
"""Prefixes of the names of statements, by group."""


def make_ranking_table(
    combinations: Sequence[RankedCombination],
    stated: Mapping[str, PublishedStatement],
    choices: Mapping[str, Sequence[str]],
    stated_choices: Mapping[str, str],
) -> pd.DataFrame:
    """Return one row per complete combination and water, followed by the dropped combinations.

    Columns are rank (0 for dropped ones), one per choice, set (its name, if any), water, text
    (whether it agrees with the text), stages, misfit and misfit_stderr (sum of squares in units of
    the tolerances; a lower bound for dropped ones), floor (transmittance that counts as 0), rms (in
    tolerances) and worst (the statement with the largest difference).
    """
    rows = []
    for combination in combinations:
        complete = combination.is_complete
        matches = combination.find_best_matches(stated)
        order = _sort_waters(matches)
        for water in order if complete else order[:1]:
            row = _make_ranking_row(combination, int(water), matches[water], stated, choices)
            rows.append(
                {
                    **row,
                    "text": combination.is_consistent_with(stated_choices),
                    "complete": complete,
                }
            )
    table = pd.DataFrame(rows)
    table = table.sort_values(["complete", "stages", "misfit"], ascending=[False, False, True])
    rank = np.where(table.complete, np.arange(1, len(table) + 1), 0)
    table.insert(0, "rank", rank)
    return table.drop(columns="complete").reset_index(drop=True)


def _make_ranking_row(
    combination: RankedCombination,
    water: int,
    match: BestMatch,
    stated: Mapping[str, PublishedStatement],
    choices: Mapping[str, Sequence[str]],
) -> dict[str, Any]:
    distances = {
        name: float(stated[name].normalize_difference(v)) for name, (v, _) in match.values.items()
    }
    worst = max(distances, key=lambda name: abs(distances[name]))
    rms, _ = match.misfit.compute_rms(len(distances))
    return {
        **{key: find_choice(combination.run.interpretation, key) for key in choices},
        "set": combination.find_set_name(),
        "water": WATER_TABLES[water],
        "stages": combination.n_stages,
        "misfit": match.misfit.total,
        "misfit_stderr": match.misfit.stderr,
        "floor": match.floor,
        "rms": rms,
        "worst": f"{worst} ({distances[worst]:+.1f})",
    }


def make_statement_table(
    combinations: Sequence[RankedCombination],
    stated: Mapping[str, PublishedStatement],
    names: Sequence[str],
) -> pd.DataFrame:
    """Return one row per statement, complete combination and water, in order of misfit.

    Parameters
    ----------
    combinations, stated
        See `splits.experiments.papers.interpretation_ranking.rank_interpretations`.
    names : sequence of str
        Fields of the interpretation that identify combinations.
    """
    rows = []
    complete = [combination for combination in combinations if combination.is_complete]
    for number, combination in enumerate(complete, start=1):
        label = combination.describe(names)
        matches = combination.find_best_matches(stated)
        for index, (water, (name, statement)) in enumerate(
            itertools.product(_sort_waters(matches), stated.items())
        ):
            value, error = matches[water].values[name]
            rows.append(
                {
                    "combination": number,
                    "interpretation": label,
                    "set": combination.find_set_name(),
                    "water": WATER_TABLES[water],
                    "nearest_water": index < len(stated),
                    "statement": name,
                    "place": statement.place,
                    "published": "above 0" if statement.is_trend else f"{statement.published:g}",
                    "ours": value,
                    "stderr": error,
                    "bar": statement.tolerance,
                    "distance": float(statement.normalize_difference(value)),
                    "between": matches[water].ranges.get(name, ""),
                    "floor": matches[water].floor if name.startswith("msi_t") else np.nan,
                }
            )
    return pd.DataFrame(rows)


def make_leave_out_table(
    combinations: Sequence[RankedCombination],
    stated: Mapping[str, PublishedStatement],
    names: Sequence[str],
) -> pd.DataFrame:
    """Return the best combination for all statements, and without each group of them.

    Columns are without, first (its interpretation), misfit, misfit_stderr, second, and margin with
    margin_stderr, the difference of the two misfits, for complete combinations.
    """
    rows = []
    complete = [combination for combination in combinations if combination.is_complete]
    for group, prefixes in {"nothing": (), **STATEMENT_GROUPS}.items():
        statements = {
            name: statement
            for name, statement in stated.items()
            if not (prefixes and name.startswith(prefixes))
        }
        best = []
        for combination in complete:
            nearest = min(
                (match.misfit for match in combination.find_best_matches(statements)),
                key=lambda misfit: misfit.total,
            )
            best.append((nearest, combination.describe(names)))
        best.sort(key=lambda pair: pair[0].total)
        if len(best) < 2:
            continue
        (first, label), (second, other) = best[:2]
        rows.append(
            {
                "without": group, "first": label, "misfit": first.total,
                "misfit_stderr": first.stderr, "second": other,
                "margin": second.total - first.total,
                "margin_stderr": float(np.hypot(first.stderr, second.stderr)),
            }
        )  # fmt: skip
    columns = ["without", "first", "misfit", "misfit_stderr", "second", "margin", "margin_stderr"]
    return pd.DataFrame(rows, columns=columns)


def find_differing_keys(combinations: Sequence[RankedCombination]) -> list[str]:
    """Return the fields in which complete combinations differ, or the first field."""
    interpretations = [
        combination.run.interpretation.as_dict()
        for combination in combinations
        if combination.is_complete
    ]
    return [
        name
        for name in interpretations[0]
        if len({combination[name] for combination in interpretations}) > 1
    ] or list(interpretations[0])[:1]


def _sort_waters(matches: Sequence[BestMatch]) -> np.ndarray:
    """Return the indices of waters in order of increasing misfit."""
    return np.argsort([match.misfit.total for match in matches])
