"""Which readings did a paper's authors run?  All combinations against all that it states.

The misfit of a combination is the sum of squared differences in bars from every number and trend
(`splits.analysis.misfit`).  But for noise it grows from stage to stage.  All combinations go
through the cheap stages; of the costly ones each takes fewer, those with the least sum so far
(`TAKEN`).  What is left behind may still have a smaller misfit than the first: this is a search,
not a proof.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from splits.analysis.misfit import Misfit, Statement, misfit, numbers_stated
from splits.experiments.published_snow import (
    NUMBERS,
    STAGES,
    WATERS,
    Errors,
    Trial,
    Values,
    trends_stated,
)
from splits.media import Readings
from splits.media.readings import SETS

TAKEN = {
    "angles": (8, 14), "transmittance": (5, 9), "facetness below": (5, 9),
    "grain size": (5, 9), "nadir": (3, 4), "grains": (3, 4), "free ranges": (3, 4),
}  # fmt: skip
"""How many combinations a stage takes of all, and of those that keep to the text, besides the sets
with a name; others take all that are left."""

LINES_EVERY = 24
"""Combinations between lines of progress."""
HOPELESS = 100.0
"""Sum of squares (ten bars once) from which a combination is simulated no further."""

BOUNDARIES = "boundaries"
GRAINS_THAT_DO_NOT_FIT = ("grain_on_last_leg", "grain_across_boundary")
"""Readings that ``boundaries`` stands for together."""


@dataclass(eq=False)
class Combination:
    """One set of readings, as far as it has been simulated.

    Attributes
    ----------
    trial : Trial
    values : dict
        Ours and its standard error by statement, shape (waters,).
    added : list of float array, shape (waters,)
        What each stage behind it adds to the sum of squares with each water.
    """

    trial: Trial
    values: Values = field(default_factory=dict)
    added: list[np.ndarray] = field(default_factory=list)

    @property
    def done(self) -> int:
        """How many stages are behind it."""
        return len(self.added)

    @property
    def least(self) -> float:
        """The least sum of squares so far with any water."""
        return float(np.sum(self.added, axis=0).min()) if self.added else 0.0

    def keeps_to(self, text: Mapping[str, str]) -> bool:
        """Tell whether the readings are those of a text."""
        own = self.trial.readings
        return all(getattr(own, name) == choice for name, choice in spelt_out(text).items())

    def is_named(self) -> bool:
        """Tell whether they are a set with a name, as people use it."""
        return self.trial.readings in [Readings.of(name) for name in SETS]

    def misfits(self, stated: Mapping[str, Statement]) -> list[Misfit]:
        """Return the misfit with each water to those statements that it has values for."""
        known = {name: stated[name] for name in stated if name in self.values}
        return [
            misfit(
                known.values(),
                [self.values[name][0][w] for name in known],
                [self.values[name][1][w] for name in known],
            )
            for w in range(len(WATERS))
        ]


def rank_readings(
    published: pd.DataFrame,
    choices: Mapping[str, Sequence[str]],
    text: Mapping[str, str],
    seed: int = 1,
    threads: int = 1,
    error_factor: float = 1.0,
    say: Callable[[str], None] = lambda line: None,
) -> tuple[list[Combination], dict[str, Statement]]:
    """Simulate combinations of readings, each as far as it may be among the first.

    Parameters
    ----------
    published : pandas.DataFrame
        See `splits.analysis.agreement.read_published`.
    choices : mapping
        Names of `splits.Readings` to the choices tried; ``boundaries`` says what becomes of both
        kinds of grains that do not fit.
    text : mapping
        What the paper says without doubt, likewise: the best of those that keep to it are followed
        to the end whatever comes before them.
    seed : int
        The same for all runs, so that combinations share random numbers where they are alike.
    threads : int
    error_factor : float
        Multiplies the errors of all runs.
    say : callable
        Receives lines of progress.

    Returns
    -------
    combinations : list of Combination
        All of them, the least misfit first.
    stated : dict
        All statements by name.
    """
    begun, given = time.perf_counter(), Errors().times(error_factor)
    stages = {
        stage: numbers_stated(published, NUMBERS.get(stage, ())) | trends_stated(stage)
        for stage in STAGES
    }
    stated = {name: s for stage in stages.values() for name, s in stage.items()}
    combinations = [
        Combination(Trial(Readings(**spelt_out(dict(zip(choices, one, strict=True)))), seed, given))
        for one in itertools.product(*choices.values())
    ]  # fmt: skip

    def further(one: Combination) -> None:
        stage = list(STAGES)[one.done]
        found = STAGES[stage](one.trial)
        one.values |= chosen(found, stages[stage])
        one.added.append(np.array([part.total for part in one.misfits(stages[stage])]))

    alive = list(combinations)
    with ThreadPoolExecutor(threads) as pool:
        for number, stage in enumerate(stages):
            alive.sort(key=lambda one: one.least)
            if stage in TAKEN:
                some, true = TAKEN[stage]
                literal = [one for one in alive if one.keeps_to(text)][:true]
                kept = [*alive[:some], *literal, *(one for one in alive if one.is_named())]
                alive = [one for one in alive if one in kept]
            if number:
                # What is off beyond all repair by what costs nothing needs no rays.
                alive = [one for one in alive if one.least < HOPELESS]
            for done, _ in enumerate(pool.map(further, alive), start=1):
                if done % LINES_EVERY == 0 or done == len(alive):
                    say(
                        f"readings: {stage}, {done} of {len(alive)}; stage {number + 1} of "
                        f"{len(stages)}; {time.perf_counter() - begun:.0f} s"
                    )
    return sorted(combinations, key=lambda one: (-one.done, one.least)), stated


def spelt_out(chosen: Mapping[str, str]) -> dict[str, str]:
    """Return choices with both readings in place of ``boundaries``."""
    rest = {name: choice for name, choice in chosen.items() if name != BOUNDARIES}
    both = {name: chosen[BOUNDARIES] for name in GRAINS_THAT_DO_NOT_FIT if BOUNDARIES in chosen}
    return rest | both


def chosen(found: Values, stated: Mapping[str, Statement]) -> Values:
    """Choose what a paper leaves open, the same for both quantities of a parameter.

    Parameters
    ----------
    found : mapping
        Arrays of shape (waters,), or (waters, pairs of extremes, floors).
    stated : mapping
        Statements of these names.
    """
    result: Values = {}
    free = [name for name, (value, _) in found.items() if value.ndim > 1]
    for parameter in dict.fromkeys(name.split("_", 2)[2] for name in free):
        names = [name for name in free if name.split("_", 2)[2] == parameter]
        distance = sum(stated[name].distance(found[name][0]) ** 2 for name in names)
        best = np.reshape(distance, (len(WATERS), -1)).argmin(axis=1)
        shape = np.shape(distance)
        for name in names:
            result[name] = tuple(
                np.broadcast_to(array, shape).reshape(len(WATERS), -1)[np.arange(len(WATERS)), best]
                for array in found[name]
            )
    return {name: result.get(name, value) for name, value in found.items()}
