"""Ranking of the interpretations of a paper by their misfit to its published statements.

The misfit of a combination is the sum over all numbers and trends of squared differences in units
of their tolerances (`splits.experiments.papers.misfit`).  Apart from noise it increases from stage
to stage.  All combinations are simulated in the cheap stages; costly stages are limited to those
with the smallest sum so far (`STAGE_QUOTAS`).  A combination that was dropped may still have a
smaller misfit than the first, so the search is heuristic.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
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
from splits.experiments.papers.overlap_choices import OVERLAP_CHOICES, OVERLAP_KEYS, OVERLAPS_KEY
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
"""Numbers of combinations that enter a stage: of all, and of those consistent with the text.  Named
sets always enter; other stages have no limit."""

LOG_INTERVAL = 24
"""Number of combinations between lines of progress."""
MAX_MISFIT = 100.0
"""Misfit (one difference of ten tolerances) above which a combination is dropped."""


PAPER_SETS = tuple(
    name for name in INTERPRETATION_SETS if Interpretation.from_input(name).grain_extent == "finite"
)
"""Named sets that can be ranked: in the papers, grains have a finite extent."""


class BestMatch(NamedTuple):
    """Values of all free choices of a paper with the smallest misfit for one water.

    Attributes
    ----------
    misfit : Misfit
    values : dict
        Our values and their standard errors by statement.
    floor : float
        Transmittance below which values count as 0 in all sensitivities.
    ranges : dict
        Extremes of the parameter for each statement on its sensitivity.
    """

    misfit: Misfit
    values: dict[str, tuple[float, float]]
    floor: float
    ranges: dict[str, str]


@dataclass(eq=False)
class RankedCombination:
    """An interpretation and the results of the stages simulated so far.

    Attributes
    ----------
    run : InterpretationRun
    values : dict
        Our values and standard errors, see
        `splits.experiments.papers.interpretation_runs.StatementValues`.
    n_stages : int
        Number of stages simulated.
    min_misfit : float
        Smallest misfit so far over all waters.
    """

    run: InterpretationRun
    values: StatementValues = field(default_factory=dict)
    n_stages: int = 0
    min_misfit: float = 0.0

    @property
    def is_complete(self) -> bool:
        """Whether all stages are simulated."""
        return self.n_stages == len(STAGES)

    def describe(self, names: Iterable[str]) -> str:
        """Return the choices of some fields of the interpretation."""
        fields = self.run.interpretation.as_dict()
        return ", ".join(f"{name}: {fields[name]}" for name in names)

    def is_consistent_with(self, stated_choices: Mapping[str, str]) -> bool:
        """Return whether the interpretation agrees with the choices that a text states."""
        interpretation = self.run.interpretation
        return all(
            getattr(interpretation, name) == choice
            for name, choice in expand_overlaps(stated_choices).items()
        )

    def find_set_name(self) -> str:
        """Return the name of the set with this interpretation, or an empty string."""
        interpretation = self.run.interpretation
        return next(
            (name for name in PAPER_SETS if Interpretation.from_input(name) == interpretation), ""
        )

    def find_best_matches(self, stated: Mapping[str, PublishedStatement]) -> list[BestMatch]:
        """Return the best match for each water, over the statements simulated so far.

        The floor is common to all sensitivities, and the pair of extremes to both of a parameter.
        """
        statements = {name: stated[name] for name in stated if name in self.values}
        return [
            min(
                (
                    self._match(statements, water, floor)
                    for floor in range(len(TRANSMITTANCE_FLOORS))
                ),
                key=lambda match: match.misfit.total,
            )
            for water in range(len(WATER_TABLES))
        ]

    def _match(
        self, statements: Mapping[str, PublishedStatement], water: int, floor: int
    ) -> BestMatch:
        """Return the best match for one water and one floor."""
        rows = {name: _select_values(self.values[name], water, floor) for name in statements}
        numbers = {name: row for name, row in rows.items() if row.ndim == 1}
        sensitivities = [name for name in rows if name not in numbers]
        ranges: dict[str, str] = {}
        for parameter in dict.fromkeys(name.split("_", 2)[2] for name in sensitivities):
            names = [name for name in sensitivities if name.endswith(f"_{parameter}")]
            distance = sum(
                statements[name].normalize_difference(rows[name][0]) ** 2 for name in names
            )
            pair = int(np.argmin(distance))
            ranges |= dict.fromkeys(names, list_extreme_pairs(parameter)[pair])
            numbers |= {name: rows[name][:, pair] for name in names}
        values = {name: (float(numbers[name][0]), float(numbers[name][1])) for name in statements}
        ours, errors = ([values[name][i] for name in statements] for i in (0, 1))
        misfit = compute_misfit(statements.values(), ours, errors)
        return BestMatch(misfit, values, TRANSMITTANCE_FLOORS[floor], ranges)


def _select_values(estimate: tuple[np.ndarray, np.ndarray], water: int, floor: int) -> np.ndarray:
    """Return a value and its error, for sensitivities of all pairs; reflectance has one floor."""
    arrays = [array[water] for array in estimate]
    return np.array([a if a.ndim == 0 else a[:, min(floor, a.shape[1] - 1)] for a in arrays])


def rank_interpretations(
    published: pd.DataFrame,
    choices: Mapping[str, Sequence[str]],
    stated_choices: Mapping[str, str],
    seed: int = 1,
    threads: int = 1,
    stderr_scale: float = 1.0,
    log: Callable[[str], None] = lambda line: None,
) -> tuple[list[RankedCombination], dict[str, PublishedStatement]]:
    """Simulate combinations of interpretations, dropping those with a large misfit.

    Parameters
    ----------
    published : pandas.DataFrame
        See `splits.analysis.measured.read_published`.
    choices : mapping
        From fields of `splits.Interpretation` to the choices varied; ``overlaps`` sets both fields
        for overlapping grains.
    stated_choices : mapping
        Choices that the paper states unambiguously.  The best combinations that agree with them
        are simulated in all stages.
    seed : int
        Common to all runs, so that similar combinations have correlated errors.
    threads : int
    stderr_scale : float
        Multiplies the errors of all runs.
    log : callable
        Receives lines of progress.

    Returns
    -------
    combinations : list of RankedCombination
        All combinations and the named sets, in order of increasing misfit.
    stated : dict
        All statements by name.
    """
    start_time, target_errors = time.perf_counter(), TargetErrors().scale(stderr_scale)
    stated: dict[str, PublishedStatement] = {}
    for stage in STAGES:
        stated |= select_statements(published, STATED_NUMBERS.get(stage, ()))
        stated |= get_stated_trends(stage)
    interpretations = [
        Interpretation(**expand_overlaps(dict(zip(choices, item, strict=True))))
        for item in itertools.product(*choices.values())
    ]
    # Named sets may differ from all combinations in fields that are not varied.
    interpretations += [
        item for item in map(Interpretation.from_input, PAPER_SETS) if item not in interpretations
    ]
    combinations = [
        RankedCombination(InterpretationRun(item, seed, target_errors)) for item in interpretations
    ]

    def advance(item: RankedCombination) -> None:
        stage = list(STAGES)[item.n_stages]
        item.values |= STAGES[stage](item.run)
        item.n_stages += 1
        item.min_misfit = min(choice.misfit.total for choice in item.find_best_matches(stated))

    active = list(combinations)
    with ThreadPoolExecutor(threads) as pool:
        for number, stage in enumerate(STAGES):
            active.sort(key=lambda item: item.min_misfit)
            if stage in STAGE_QUOTAS:
                n_all, n_consistent = STAGE_QUOTAS[stage]
                consistent = [item for item in active if item.is_consistent_with(stated_choices)]
                named = [item for item in active if item.find_set_name()]
                selected = [*active[:n_all], *consistent[:n_consistent], *named]
                active = [item for item in active if item in selected]
            if number:
                # Combinations with a large misfit are dropped, except for the best two.
                active = [
                    item for i, item in enumerate(active)
                    if i < 2 or item.min_misfit < MAX_MISFIT or item.find_set_name()
                ]  # fmt: skip
            for done, _ in enumerate(pool.map(advance, active), start=1):
                if done % LOG_INTERVAL == 0 or done == len(active):
                    log(
                        f"interpretation: {stage}, {done} of {len(active)}; stage {number + 1} of "
                        f"{len(STAGES)}; {time.perf_counter() - start_time:.0f} s"
                    )
    return sorted(combinations, key=lambda item: (-item.n_stages, item.min_misfit)), stated


def expand_overlaps(choices: Mapping[str, str]) -> dict[str, str]:
    """Return choices with ``overlaps`` replaced by the two fields that it sets."""
    rest = {name: choice for name, choice in choices.items() if name != OVERLAPS_KEY}
    values = OVERLAP_CHOICES[choices[OVERLAPS_KEY]] if OVERLAPS_KEY in choices else ()
    return rest | dict(zip(OVERLAP_KEYS, values, strict=bool(values)))


def find_choice(interpretation: Interpretation, name: str) -> str:
    """Return the choice of an interpretation for a key, the inverse of `expand_overlaps`."""
    fields = interpretation.as_dict()
    if name != OVERLAPS_KEY:
        return fields[name]
    values = tuple(fields[key] for key in OVERLAP_KEYS)
    return next(choice for choice, pair in OVERLAP_CHOICES.items() if pair == values)
