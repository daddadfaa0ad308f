"""Retrieval where noise is not known: least squares, whose misfit says how far they may be off.

The place of the least misfit, with the covariance that `splits.retrieval.misfit` finds, is then
taken for a measurement of the coordinates themselves.  Ranges, priors, and what is told follow as
they do where noise is known.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from splits.checks import refuse
from splits.retrieval.coordinates import Free
from splits.retrieval.estimation import RIVAL, Optimum, Told, held_at, optima, told
from splits.retrieval.forward import OfTable
from splits.retrieval.line import Around, Seen, bent
from splits.retrieval.measurement import Measurement
from splits.retrieval.misfit import SPARE, Left, left_open
from splits.retrieval.posterior import Draws, draws_of
from splits.retrieval.result import Found, tension_of
from splits.retrieval.runs import OfRuns


class Estimated(NamedTuple):
    """What an estimate tells, within ranges and with priors.

    Attributes
    ----------
    place : float, shape (parameters,)
        The most probable one.
    told : Told
    draws : Draws
    tension : float, shape (parameters,)
        See `splits.retrieval.result.Found`.
    """

    place: np.ndarray
    told: Told
    draws: Draws
    tension: np.ndarray


def estimated(free: Free, place: np.ndarray, covariance: np.ndarray, seed: int) -> Estimated:
    """Return what an estimate of the coordinates tells.

    Parameters
    ----------
    free : Free
    place : float, shape (parameters,)
    covariance : float, shape (parameters, parameters)
        See `splits.retrieval.misfit.left_open`.
    seed : int
        Of the draws.
    """
    many = len(place)
    measurement = Measurement(place, np.arange(many, dtype=float), covariance, {})
    itself = Around(free, Seen(place, place, np.eye(many), np.zeros((many, many))))
    ends = optima(itself, measurement, *itself.nodes())
    draws = draws_of(itself, measurement, ends, seed)
    tension = tension_of(free, place, np.diag(covariance))
    return Estimated(ends[0].place, told(ends[0], free), draws, tension)


def in_table(model: OfTable, measurement: Measurement, seed: int) -> tuple[Found, Measurement]:
    """Return what a measurement of unknown noise tells in a table, and the noise found."""
    check_enough(len(model.free.names), measurement)
    free = model.free
    model.free = free.flat()
    best, *others = sorted(optima(model, measurement, *model.nodes()), key=lambda end: end.cost)
    own = model.covariance(best.place)
    model.free = free
    left = left_open([best.slopes] * 2, best.values - measurement.values, own, best.held)
    around = Around(free, Seen(best.place, best.values, best.slopes, own))
    within = RIVAL * float(left.of_values[0, 0])
    rivals = tuple(end.place for end in others if end.cost < best.cost + within)
    return _found(lambda x: model.with_slopes(x)[0], around, measurement, left, rivals, seed)


def by_runs(runs: OfRuns, measurement: Measurement, seed: int) -> tuple[Found, Measurement]:
    """Return what a measurement of unknown noise tells by runs, and the noise found."""
    check_enough(len(runs.free.names), measurement)
    free = runs.free
    runs.free = free.flat()
    settled = runs.settled()
    runs.free = free
    best = settled.seen(measurement.covariance)
    off = best.values - measurement.values
    held = held_at(best.place, best.slopes.T @ off)
    left = left_open(settled.jacobians, off, best.covariance, held)
    rivals = settled.rivals(RIVAL * float(left.of_values[0, 0]))
    return _found(runs.last, Around(free, best), measurement, left, rivals, seed)


def check_enough(free: int, measurement: Measurement) -> None:
    """Refuse a measurement of unknown noise with too few values for so many free parameters."""
    least, count = free + SPARE, measurement.values.size
    if not measurement.told and count < least:
        hint = f"{count} values are too few to find it from the misfit, {least} are needed"
        raise refuse("noise", None, "given", hint)


def _found(
    values: Callable[[np.ndarray], np.ndarray],
    around: Around,
    measurement: Measurement,
    left: Left,
    rivals: tuple[np.ndarray, ...],
    seed: int,
) -> tuple[Found, Measurement]:
    """Return what was found as where noise is known, and the measurement with the noise found."""
    best = around.seen
    found = estimated(around.free, best.place, left.of_place, seed)
    there = values(found.place)
    whole = left.of_values + best.covariance
    off = there - measurement.values
    chi2 = float(off @ np.linalg.solve(whole, off))
    held = held_at(found.place, best.slopes.T @ np.linalg.solve(whole, off))
    end = Optimum(found.place, there, best.slopes, whole, chi2, chi2, held)
    own = np.sqrt(np.diag(best.covariance))
    curved = bent(values, around, found.place, found.told.covariance, whole)
    plain = Found([end], found.told, found.draws, 1.0, found.tension, own, rivals, curved)
    return plain, measurement._replace(covariance=left.of_values)
