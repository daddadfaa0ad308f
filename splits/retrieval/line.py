"""A measurement as a straight line through one place has it, and how far light is off that line."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from splits.retrieval.coordinates import Free

MARGIN = 1e-3
"""At the very ends of ranges slopes may be infinite."""


class Seen(NamedTuple):
    """A medium that was looked at.

    Attributes
    ----------
    place : float, shape (parameters,)
        Coordinates.
    values : float, shape (n,)
        What would be measured.
    slopes : float, shape (n, parameters)
    covariance : float, shape (n, n)
        Of the runs' noise.
    """

    place: np.ndarray
    values: np.ndarray
    slopes: np.ndarray
    covariance: np.ndarray


class Around:
    """A measurement as a straight line through one place has it; see `splits.retrieval.forward`."""

    def __init__(self, free: Free, seen: Seen) -> None:
        self.free, self.seen = free, seen

    def values(self, places: np.ndarray) -> np.ndarray:
        """Return what would be measured, shape (places, n)."""
        found: np.ndarray = self.seen.values + (places - self.seen.place) @ self.seen.slopes.T
        return found

    def with_slopes(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what would be measured, shape (n,), and slopes, shape (n, parameters)."""
        return self.values(place[np.newaxis])[0], self.seen.slopes

    def covariance(self, place: np.ndarray) -> np.ndarray:
        """Return the covariance of the runs' noise, shape (n, n)."""
        return self.seen.covariance

    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return where descents begin, and what would be measured there."""
        return self.seen.place[np.newaxis], self.seen.values[np.newaxis]


def bent(
    values: Callable[[np.ndarray], np.ndarray],
    around: Around,
    place: np.ndarray,
    covariance: np.ndarray,
    noise: np.ndarray,
) -> float:
    """Return how far light is off a straight line, a standard deviation away, in its noise.

    Parameters
    ----------
    values : callable
        What would be measured at a place, shape (n,).
    around : Around
    place : float, shape (parameters,)
        The most probable one.
    covariance : float, shape (parameters, parameters)
        Of coordinates, after; the widest way is looked along.
    noise : float, shape (n, n)
        Covariance of measurement and model.
    """
    sizes, ways = np.linalg.eigh(covariance)
    lower = np.linalg.cholesky(noise)
    most = 0.0
    for sign in (-1.0, 1.0):
        there = place + sign * np.sqrt(sizes[-1]) * ways[:, -1]
        there = np.clip(there, MARGIN, 1.0 - MARGIN)
        off = values(there) - around.values(there[np.newaxis])[0]
        most = max(most, float(np.linalg.norm(np.linalg.solve(lower, off))))
    return most
