"""Which readings did a paper's authors run?  All combinations against all that it states.

The misfit of a combination is the sum of squared differences in bars from every number and trend
(`splits.experiments.papers.misfit`).  But for noise it grows from stage to stage.  All combinations go
through the cheap stages; of the costly ones each takes fewer, those with the least sum so far
(`STAGE_QUOTAS`).  What is left behind may still have a smaller misfit than the first: this is a search,
not a proof.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd

from splits.experiments.papers.interpretation_runs import (
    WATER_TABLES,
    InterpretationRun,
    StatementValues,
    TargetErrors,
)
from splits.experiments.papers.misfit import (
    Misfit,
    PublishedStatement,
    compute_misfit,
    select_statements,
)
from splits.experiments.papers.snow_statements import (
    STAGES,
    STATED_NUMBERS,
    TRANSMITTANCE_FLOORS,
    get_stated_trends,
    list_extreme_pairs,
)
from splits.media import Interpretation
from splits.media.interpretations import INTERPRETATION_SETS

STAGE_QUOTAS = {
    "angles": (32, 32), "transmittance": (16, 16), "facetness below": (16, 16),
    "grain size": (16, 16), "nadir": (7, 7), "grains": (7, 7), "free ranges": (7, 7),
}  # fmt: skip
"""How many combinations a stage takes of all, and of those that keep to the text, besides the sets
with a name; others take all that are left."""

LOG_INTERVAL = 24
"""Combinations between lines of progress."""
MAX_MISFIT = 100.0
"""Sum of squares (ten bars once) from which a combination is simulated no further."""

BOUNDARIES_KEY = "overlaps"
PAPER_SETS = tuple(
    name for name in INTERPRETATION_SETS if Interpretation.from_input(name).grain_extent == "finite"
)
"""Sets that can be ranked by what the papers state: the papers' grains have an extent."""
OVERLAP_KEYS = ("overlap_with_previous_segment", "overlap_with_boundary")
"""Readings that ``overlaps`` stands for together."""
OVERLAP_CHOICES = {
    "reject": ("reject", "reject"),
    "keep": ("keep", "keep"),
    "skip": ("skip", "skip"),
    "segment overlap kept": ("keep", "reject"),
}
"""What ``overlaps`` may be, and those readings."""


class BestMatch(NamedTuple):
    """What a paper leaves open, chosen with one water to come as near as can be.

    Attributes
    ----------
    misfit : Misfit
    values : dict
        Ours and its standard error by statement.
    floor : float
        Transmittance below which light counts as none in all sensitivities.
    ranges : dict
        Extremes of a parameter by the statements of its sensitivities.
    """

    misfit: Misfit
    values: dict[str, tuple[float, float]]
    floor: float
    ranges: dict[str, str]


@dataclass(eq=False)
class InterpretationSet:
    """One set of readings, as far as it has been simulated.

    Attributes
    ----------
    run : InterpretationRun
    values : dict
        Ours and its standard error by statement, see `splits.experiments.papers.interpretation_runs.StatementValues`.
    n_stages : int
        How many stages are behind it.
    min_misfit : float
        The least sum of squares so far with any water.
    """

    run: InterpretationRun
    values: StatementValues = field(default_factory=dict)
    n_stages: int = 0
    min_misfit: float = 0.0

    def is_consistent_with(self, stated_choices: Mapping[str, str]) -> bool:
        """Tell whether the readings are those of a text."""
        own = self.run.interpretation
        return all(
            getattr(own, name) == choice
            for name, choice in expand_boundaries(stated_choices).items()
        )

    def find_set_name(self) -> str:
        """Return the name that these readings have as a set, nothing if they have none."""
        own = self.run.interpretation
        return next((name for name in PAPER_SETS if Interpretation.from_input(name) == own), "")

    def find_best_matches(self, stated: Mapping[str, PublishedStatement]) -> list[BestMatch]:
        """Return the nearest choice with each water, of those statements that it has values for.

        One floor holds for all sensitivities, one pair of extremes for both of a parameter.
        """
        known = {name: stated[name] for name in stated if name in self.values}
        return [
            min(
                (self._match(known, w, f) for f in range(len(TRANSMITTANCE_FLOORS))),
                key=lambda c: c.misfit.total,
            )
            for w in range(len(WATER_TABLES))
        ]

    def _match(
        self, statements: Mapping[str, PublishedStatement], water: int, floor: int
    ) -> BestMatch:
        """Return the choice with one water and one floor."""
        rows = {
            name: np.array([array[water] if array.ndim == 1 else _select_floor(array[water], floor)
                            for array in self.values[name]])
            for name in statements
        }  # fmt: skip
        values: dict[str, tuple[float, float]] = {}
        ranges: dict[str, str] = {}
        for parameter, names in _group_by_parameter(rows).items():
            distance = sum(
                statements[name].normalize_difference(rows[name][0]) ** 2 for name in names
            )
            pair = int(np.argmin(distance))
            label = list_extreme_pairs(parameter)[pair]
            ranges |= dict.fromkeys(names, label)
            values |= {name: _to_pair(rows[name][:, pair]) for name in names}
        values |= {name: _to_pair(row) for name, row in rows.items() if row.ndim == 1}
        ours, errors = (
            zip(*(values[name] for name in statements), strict=True) if statements else ((), ())
        )
        found = compute_misfit(statements.values(), ours, errors)
        return BestMatch(found, values, TRANSMITTANCE_FLOORS[floor], ranges)


def _to_pair(row: np.ndarray) -> tuple[float, float]:
    return float(row[0]), float(row[1])


def _select_floor(array: np.ndarray, floor: int) -> np.ndarray:
    """Return the sensitivities of all pairs with a floor; reflectance has none."""
    return array[:, min(floor, array.shape[1] - 1)]


def _group_by_parameter(rows: Mapping[str, np.ndarray]) -> dict[str, list[str]]:
    """Return the sensitivities by parameter."""
    found: dict[str, list[str]] = {}
    for name, row in rows.items():
        if row.ndim > 1:
            found.setdefault(name.split("_", 2)[2], []).append(name)
    return found


def rank_interpretations(
    published: pd.DataFrame,
    choices: Mapping[str, Sequence[str]],
    stated_choices: Mapping[str, str],
    seed: int = 1,
    threads: int = 1,
    stderr_scale: float = 1.0,
    log: Callable[[str], None] = lambda line: None,
) -> tuple[list[InterpretationSet], dict[str, PublishedStatement]]:
    """Simulate combinations of readings, each as far as it may be among the first.

    Parameters
    ----------
    published : pandas.DataFrame
        See `splits.experiments.papers.agreement.read_published`.
    choices : mapping
        Names of `splits.Interpretation` to the choices tried; ``overlaps`` says what becomes of both
        kinds of grains that do not fit.
    stated_choices : mapping
        What the paper says without doubt, likewise: the best of those that keep to it are followed
        to the end whatever comes before them.
    seed : int
        The same for all runs, so that combinations share random numbers where they are alike.
    threads : int
    stderr_scale : float
        Multiplies the errors of all runs.
    log : callable
        Receives lines of progress.

    Returns
    -------
    combinations : list of InterpretationSet
        All of them, and the sets with a name besides, the least misfit first.
    stated : dict
        All statements by name.
    """
    begun, given = time.perf_counter(), TargetErrors().scale(stderr_scale)
    stages = {
        stage: select_statements(published, STATED_NUMBERS.get(stage, ()))
        | get_stated_trends(stage)
        for stage in STAGES
    }
    stated = {name: s for stage in stages.values() for name, s in stage.items()}
    interpretation = [
        Interpretation(**expand_boundaries(dict(zip(choices, one, strict=True))))
        for one in itertools.product(*choices.values())
    ]
    # Sets with a name may differ from all of them in readings that are not tried.
    interpretation += [
        one for one in map(Interpretation.from_input, PAPER_SETS) if one not in interpretation
    ]
    combinations = [
        InterpretationSet(InterpretationRun(one, seed, given)) for one in interpretation
    ]

    def further(one: InterpretationSet) -> None:
        stage = list(STAGES)[one.n_stages]
        one.values |= STAGES[stage](one.run)
        one.n_stages += 1
        one.min_misfit = min(choice.misfit.total for choice in one.find_best_matches(stated))

    alive = list(combinations)
    with ThreadPoolExecutor(threads) as pool:
        for number, stage in enumerate(stages):
            alive.sort(key=lambda one: one.min_misfit)
            if stage in STAGE_QUOTAS:
                some, true = STAGE_QUOTAS[stage]
                literal = [one for one in alive if one.is_consistent_with(stated_choices)][:true]
                kept = [*alive[:some], *literal, *(one for one in alive if one.find_set_name())]
                alive = [one for one in alive if one in kept]
            if number:
                # What is off beyond all repair by what costs nothing needs no rays, but two do.
                alive = [
                    one for i, one in enumerate(alive)
                    if i < 2 or one.min_misfit < MAX_MISFIT or one.find_set_name()
                ]  # fmt: skip
            for done, _ in enumerate(pool.map(further, alive), start=1):
                if done % LOG_INTERVAL == 0 or done == len(alive):
                    log(
                        f"interpretation: {stage}, {done} of {len(alive)}; stage {number + 1} of "
                        f"{len(stages)}; {time.perf_counter() - begun:.0f} s"
                    )
    return sorted(combinations, key=lambda one: (-one.n_stages, one.min_misfit)), stated


def expand_boundaries(choices: Mapping[str, str]) -> dict[str, str]:
    """Return choices with both readings in place of ``overlaps``."""
    rest = {name: choice for name, choice in choices.items() if name != BOUNDARIES_KEY}
    fates = OVERLAP_CHOICES[choices[BOUNDARIES_KEY]] if BOUNDARIES_KEY in choices else ()
    return rest | dict(zip(OVERLAP_KEYS, fates, strict=bool(fates)))


def find_choice(interpretation: Interpretation, name: str) -> str:
    """Return the choice that readings make of one name of a study, the inverse of `expand_boundaries`."""
    own = interpretation.as_dict()
    if name != BOUNDARIES_KEY:
        return own[name]
    fates = tuple(own[one] for one in OVERLAP_KEYS)
    return next(choice for choice, both in OVERLAP_CHOICES.items() if both == fates)
