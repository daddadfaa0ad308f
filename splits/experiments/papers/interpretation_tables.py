"""Tables of a ranking of interpretations, see `interpretation_ranking`."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import astuple
from operator import attrgetter
from typing import Any

import numpy as np
import pandas as pd

from splits.experiments.papers.estimate import Estimate
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
            misfit, values, floor, _ = matches[water]
            distances = {
                name: float(stated[name].normalize_difference(v)) for name, (v, _) in values.items()
            }
            worst = max(distances, key=lambda name: abs(distances[name]))
            choice_of = {key: find_choice(combination.run.interpretation, key) for key in choices}
            row = {
                **choice_of, "set": combination.find_set_name(), "water": WATER_TABLES[water],
                "stages": combination.n_stages, "misfit": misfit.total,
                "misfit_stderr": misfit.stderr, "floor": floor,
                "rms": misfit.compute_rms(len(distances))[0],
                "worst": f"{worst} ({distances[worst]:+.1f})",
                "text": combination.is_consistent_with(stated_choices), "complete": complete,
            }  # fmt: skip
            rows.append(row)
    table = pd.DataFrame(rows)
    table = table.sort_values(["complete", "stages", "misfit"], ascending=[False, False, True])
    rank = np.where(table.complete, np.arange(1, len(table) + 1), 0)
    table.insert(0, "rank", rank)
    return table.drop(columns="complete").reset_index(drop=True)


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
    rows: list[dict[str, Any]] = []
    for number, combination in enumerate(_list_complete(combinations), start=1):
        matches = combination.find_best_matches(stated)
        nearest, *_ = order = _sort_waters(matches)
        for water, (name, statement) in itertools.product(order, stated.items()):
            _, values, floor, ranges = matches[water]
            value, error = values[name]
            row = {
                "combination": number, "interpretation": combination.describe(names),
                "set": combination.find_set_name(), "water": WATER_TABLES[water],
                "nearest_water": bool(water == nearest), "statement": name,
                "place": statement.place,
                "published": "above 0" if statement.is_trend else f"{statement.published:g}",
                "ours": value, "stderr": error, "bar": statement.tolerance,
                "distance": float(statement.normalize_difference(value)),
                "between": ranges.get(name, ""),
                "floor": floor if name.startswith("msi_t") else np.nan,
            }  # fmt: skip
            rows.append(row)
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
    columns = ["without", "first", "misfit", "misfit_stderr", "second", "margin", "margin_stderr"]
    rows = []
    for group, prefixes in {"nothing": (), **STATEMENT_GROUPS}.items():
        statements = {
            name: statement
            for name, statement in stated.items()
            if not (prefixes and name.startswith(prefixes))
        }
        best = []
        for combination in _list_complete(combinations):
            misfits = [match.misfit for match in combination.find_best_matches(statements)]
            best.append((min(misfits, key=attrgetter("total")), combination.describe(names)))
        if len(best) > 1:
            (first, label), (second, other), *_ = sorted(best, key=lambda pair: pair[0].total)
            margin = Estimate(*astuple(second)) - Estimate(*astuple(first))
            rows.append((group, label, *astuple(first), other, *margin.to_floats()))
    return pd.DataFrame(rows, columns=columns)


def find_differing_keys(combinations: Sequence[RankedCombination]) -> list[str]:
    """Return the fields in which complete combinations differ, or the first field."""
    complete = _list_complete(combinations)
    table = pd.DataFrame([combination.run.interpretation.as_dict() for combination in complete])
    return list(table.columns[table.nunique() > 1]) or list(table.columns[:1])


def _list_complete(combinations: Sequence[RankedCombination]) -> list[RankedCombination]:
    return [combination for combination in combinations if combination.is_complete]


def _sort_waters(matches: Sequence[BestMatch]) -> list[int]:
    """Return the indices of waters in order of increasing misfit."""
    return [int(i) for i in np.argsort([match.misfit.total for match in matches])]
