"""Tables of a ranking of readings, see `splits.experiments.papers.interpretation_ranking`."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from splits.experiments.papers.interpretation_ranking import (
    BestMatch,
    InterpretationSet,
    find_choice,
)
from splits.experiments.papers.interpretation_runs import WATER_TABLES
from splits.experiments.papers.misfit import PublishedStatement
from splits.experiments.papers.snow_statements import STAGES

STATEMENT_GROUPS = {
    "Table 3": ("table3",),
    "transmittance": ("transmittance",),
    "sensitivities, stated ranges": ("msi_r_grain", "msi_t_grain", "msi_r_facet", "msi_t_facet"),
    "sensitivities, free ranges": ("msi_r_sat", "msi_t_sat", "msi_r_dens", "msi_t_dens"),
    "angles": ("fig",),
}
"""Groups of statements by the beginnings of their names."""


def make_ranking_table(
    combinations: Sequence[InterpretationSet],
    stated: Mapping[str, PublishedStatement],
    choices: Mapping[str, Sequence[str]],
    stated_choices: Mapping[str, str],
) -> pd.DataFrame:
    """Return one row per combination and water that went through all stages, then the others.

    Columns rank (0 for the others), one per choice, set (a name that these readings have), water,
    text (whether it keeps to it), stages, misfit and misfit_stderr (sum of squares in bars; of the
    others that so far, which bounds theirs from below), floor (transmittance that counts as none),
    rms (in bars) and worst (the statement furthest off).
    """
    rows = []
    for one in combinations:
        complete = one.n_stages == len(STAGES)
        found = one.find_best_matches(stated)
        order = _sort_waters(found)
        for water in order if complete else order[:1]:
            row = _make_ranking_row(one, int(water), found[water], stated, choices)
            rows.append(
                {**row, "text": one.is_consistent_with(stated_choices), "complete": complete}
            )
    table = pd.DataFrame(rows)
    table = table.sort_values(["complete", "stages", "misfit"], ascending=[False, False, True])
    rank = np.where(table.complete, np.arange(1, len(table) + 1), 0)
    table.insert(0, "rank", rank)
    return table.drop(columns="complete").reset_index(drop=True)


def _make_ranking_row(
    combination: InterpretationSet,
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
    combinations: Sequence[InterpretationSet],
    stated: Mapping[str, PublishedStatement],
    names: Sequence[str],
) -> pd.DataFrame:
    """Return one row per statement, complete combination and water, the nearest water first.

    Parameters
    ----------
    combinations, stated
        See `splits.experiments.papers.interpretation_ranking.rank_interpretations`.
    names : sequence of str
        Readings that tell combinations apart.
    """
    rows = []
    complete = [one for one in combinations if one.n_stages == len(STAGES)]
    for number, one in enumerate(complete, start=1):
        own = one.run.interpretation.as_dict()
        label = ", ".join(f"{name}: {own[name]}" for name in names)
        found = one.find_best_matches(stated)
        for place, (water, (name, statement)) in enumerate(
            itertools.product(_sort_waters(found), stated.items())
        ):
            value, error = found[water].values[name]
            rows.append(
                {
                    "combination": number, "interpretation": label, "set": one.find_set_name(),
                    "water": WATER_TABLES[water],
                    "nearest_water": place < len(stated),
                    "statement": name, "place": statement.place,
                    "published": "above 0" if statement.is_trend else f"{statement.published:g}",
                    "ours": value, "stderr": error, "bar": statement.tolerance,
                    "distance": float(statement.normalize_difference(value)),
                    "between": found[water].ranges.get(name, ""),
                    "floor": found[water].floor if name.startswith("msi_t") else np.nan,
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def make_leave_out_table(
    combinations: Sequence[InterpretationSet],
    stated: Mapping[str, PublishedStatement],
    names: Sequence[str],
) -> pd.DataFrame:
    """Return which combination is first with all statements, and without each group of them.

    Columns without, first (its readings), misfit, misfit_stderr, second, margin, margin_stderr: by
    how much the second one's misfit is larger, of those that went through all stages.
    """
    rows = []
    complete = [one for one in combinations if one.n_stages == len(STAGES)]
    for group, beginnings in {"nothing": (), **STATEMENT_GROUPS}.items():
        kept = {n: s for n, s in stated.items() if not (beginnings and n.startswith(beginnings))}
        best = []
        for one in complete:
            nearest = min((c.misfit for c in one.find_best_matches(kept)), key=lambda m: m.total)
            own = one.run.interpretation.as_dict()
            label = ", ".join(f"{name}: {own[name]}" for name in names)
            best.append((nearest, label))
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


def find_differing_keys(combinations: Sequence[InterpretationSet]) -> list[str]:
    """Return the readings in which complete combinations differ, the first where none does."""
    own = [one.run.interpretation.as_dict() for one in combinations if one.n_stages == len(STAGES)]
    return [name for name in own[0] if len({one[name] for one in own}) > 1] or list(own[0])[:1]


def _sort_waters(matches: Sequence[BestMatch]) -> np.ndarray:
    """Return the numbers of waters, that with the least misfit first."""
    return np.argsort([choice.misfit.total for choice in matches])
