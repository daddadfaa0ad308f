"""Retrieval where noise is not known: least squares, whose misfit says how far they may be off.

The place of the least misfit, with the covariance that `splits.retrieval.misfit` finds, is then
taken for a measurement of the coordinates themselves.  Ranges, priors, and what is told follow as
they do where noise is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.checks import refuse
from splits.retrieval.coordinates import Free
from splits.retrieval.estimation import APART, RIVAL, Optimum, Told, optima, told
from splits.retrieval.forward import OfTable
from splits.retrieval.measurement import Measurement
from splits.retrieval.misfit import left_open
from splits.retrieval.posterior import Draws, draws_of
from splits.retrieval.result import Found, tension_of
from splits.retrieval.runs import LAST, Around, OfRuns, Seen

JACOBIANS = 2
"""Independent ones behind the errors of retrievals by runs."""


class Estimated(NamedTuple):
    """What a place of least misfit tells, within ranges and with priors.

    Attributes
    ----------
    place : float, shape (parameters,)
        The most probable one.
    told : Told
    draws : Draws
    covariance : float, shape (n, n)
        Of what the misfit was drawn from.
    tension : float, shape (parameters,)
        See `splits.retrieval.result.Found`.
    """

    place: np.ndarray
    told: Told
    draws: Draws
    covariance: np.ndarray
    tension: np.ndarray


def estimated(
    free: Free,
    place: np.ndarray,
    jacobians: Sequence[np.ndarray],
    misfit: np.ndarray,
    own: np.ndarray,
    seed: int,
) -> Estimated:
    """Return what a place of least misfit tells.

    Parameters
    ----------
    free : Free
    place : float, shape (parameters,)
    jacobians : sequence of float, shape (n, parameters)
        Independent ones, two at least.
    misfit : float, shape (n,)
        Model minus measurement.
    own : float, shape (n, n)
        Covariance of the noise that all runs, or cells of a table, share.
    seed : int
        Of the draws.
    """
    left = left_open(jacobians, misfit, own)
    model, itself = _itself(free, place, left.of_place)
    ends = optima(model, itself, *model.nodes())
    draws = draws_of(model, itself, ends, seed)
    tension = tension_of(free, place, np.diag(left.of_place))
    return Estimated(ends[0].place, told(ends[0], model), draws, left.of_values, tension)


def draws_around(free: Free, place: np.ndarray, covariance: np.ndarray, seed: int) -> Draws:
    """Return draws around an estimate with a covariance, within ranges and with priors."""
    model, itself = _itself(free, place, covariance)
    return draws_of(model, itself, optima(model, itself, *model.nodes()), seed)


def _itself(free: Free, place: np.ndarray, covariance: np.ndarray) -> tuple[Around, Measurement]:
    """Return an estimate of the coordinates as a measurement of these."""
    many = len(place)
    measurement = Measurement(place, np.arange(many, dtype=float), covariance, {})
    return Around(free, Seen(place, place, np.eye(many), np.zeros((many, many)))), measurement


def in_table(model: OfTable, measurement: Measurement, seed: int) -> tuple[Found, Measurement]:
    """Return what a measurement of unknown noise tells in a table, and the noise found."""
    _check(model.free, measurement)
    free = model.free
    model.free = _flat(free)
    best, *others = optima(model, measurement, *model.nodes())
    own = model.covariance(best.place)
    model.free = free
    off = best.values - measurement.values
    found = estimated(free, best.place, [best.slopes] * 2, off, own, seed)
    values, slopes = model.with_slopes(found.place)
    rivals = [free.at(end.place) for end in _rivals(others, best, found)]
    seen = Seen(found.place, values, slopes, own)
    return _found(seen, found, measurement, rivals)


def by_runs(runs: OfRuns, measurement: Measurement, seed: int) -> tuple[Found, Measurement]:
    """Return what a measurement of unknown noise tells by runs, and the noise found."""
    _check(runs.free, measurement)
    free = runs.free
    runs.free = _flat(free)
    around, others = runs.settled()
    runs.free = free
    best = around.seen
    jacobians = [runs.slopes(best.place, LAST, seed + 1 + n) for n in range(JACOBIANS)]
    off = best.values - measurement.values
    found = estimated(free, best.place, jacobians, off, best.covariance, seed)
    seen = best._replace(place=found.place, values=around.values(found.place[np.newaxis])[0])
    return _found(seen, found, measurement, [free.at(place) for place in others])


def _check(free: Free, measurement: Measurement) -> None:
    """Refuse too few values to tell noise."""
    least, count = len(free.names) + 2, measurement.values.size
    if count < least:
        hint = f"{count} values are too few to find it from the misfit, {least} are needed"
        raise refuse("noise", None, "given", hint)


def _flat(free: Free) -> Free:
    """Return what is free without priors."""
    return free._replace(prior_sd=np.full(len(free.names), np.inf))


def _rivals(others: Sequence[Optimum], best: Optimum, found: Estimated) -> list[Optimum]:
    """Return other ends that explain a measurement nearly as well."""
    variance = float(found.covariance[0, 0])
    return [
        end for end in others
        if end.cost < best.cost + RIVAL * variance and np.abs(end.place - best.place).max() > APART
    ]  # fmt: skip


def _found(
    seen: Seen, found: Estimated, measurement: Measurement, rivals: Sequence[np.ndarray]
) -> tuple[Found, Measurement]:
    """Return what was found as where noise is known, and the measurement with the noise found."""
    whole = found.covariance + seen.covariance
    off = seen.values - measurement.values
    chi2 = float(off @ np.linalg.solve(whole, off))
    end = Optimum(seen.place, seen.values, seen.slopes, whole, chi2, chi2)
    own = np.sqrt(np.diag(seen.covariance))
    plain = Found([end], found.told, found.draws, 1.0, found.tension, own, tuple(rivals))
    return plain, measurement._replace(covariance=found.covariance)
