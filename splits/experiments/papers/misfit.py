"""How far a model lies from everything that a paper states about it, in one number.

A stated number has a bar: the difference up to which ours counts as agreeing, as in the tables of
agreement.  The misfit of a set of statements is the sum of squares of their differences in bars.
A statement in words, that something is larger than something else, adds only where it fails.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

TREND_TOLERANCE = 0.1
"""Failure of a trend that counts as one bar, as a part of what is compared (a nadir's brightness,
a peak's height)."""

MAX_SIGMA = 8.0
"""Errors by which a trend holds beyond any doubt; differences of large terms are noise there."""


@dataclass(frozen=True)
class PublishedStatement:
    """One thing that a paper states.

    Attributes
    ----------
    name, place : str
        Its id, and where it stands in the paper.
    published : float
        The number, or 0 for a trend, whose value is to be above.
    tolerance : float
        Above 0.
    is_trend : bool
        Whether only values below `published` count against a model.
    """

    name: str
    place: str
    published: float
    tolerance: float
    is_trend: bool = False

    def normalize_difference(self, ours: np.ndarray | float) -> np.ndarray:
        """Return the signed difference from what is stated, in bars; 0 for a trend that holds."""
        difference = (np.asarray(ours, dtype=float) - self.published) / self.tolerance
        return np.minimum(difference, 0.0) if self.is_trend else difference


def select_statements(
    published: pd.DataFrame, names: Iterable[str]
) -> dict[str, PublishedStatement]:
    """Return statements of numbers by name.

    Parameters
    ----------
    published : pandas.DataFrame
        See `splits.experiments.papers.agreement.read_published`.  Where limits stand instead of a bar, half
        the distance between them is the bar.
    names : iterable of str
        Ids in that table.
    """
    found = {}
    for name in names:
        row = published.loc[name]
        if isinstance(row.bar, str):
            part = abs(row.published) / 100.0 if row.bar.endswith("%") else 1.0
            bar = float(row.bar.rstrip("%")) * part
        else:
            bar = 0.5 * (float(row.high) - float(row.low))
        found[name] = PublishedStatement(name, str(row.place), float(row.published), bar)
    return found


@dataclass(frozen=True)
class Misfit:
    """Sum of squares of differences in bars.

    Attributes
    ----------
    total : float
        Without what the errors of our values add to it on average.
    stderr : float
    """

    total: float
    stderr: float

    def compute_rms(self, n_statements: int) -> tuple[float, float]:
        """Return the root-mean-square difference in bars over `n_statements` statements, and its error."""
        value = float(np.sqrt(max(self.total, 0.0) / n_statements))
        spread = self.stderr / n_statements
        return value, float(spread / (2.0 * value)) if value > 0.0 else float(np.sqrt(spread))


def compute_misfit(
    statements: Iterable[PublishedStatement], ours: Iterable[float], stderr: Iterable[float]
) -> Misfit:
    """Return the misfit of values with independent errors.

    With a difference d of error e (both in bars), d² is e² too large on average and has the
    variance 4 d² e² + 2 e⁴.  A trend that fails counts alike.  One that holds by z errors adds
    nothing but the chance that it fails in truth: the mean of the squared sum of squares over a
    normal distribution of what the truth may be, e⁴ ((z⁴ + 6z² + 3) Φ(−z) − (z³ + 5z) φ(z)).
    """
    total, variance = 0.0, 0.0
    for statement, value, error in zip(statements, ours, stderr, strict=True):
        distance = float(statement.normalize_difference(value))
        noise = (error / statement.tolerance) ** 2
        if statement.is_trend and distance == 0.0:
            z = value / error if error > 0.0 else np.inf
            variance += noise**2 * _compute_tail_fourth_moment(z)
            continue
        total += max(distance**2 - noise, 0.0) if statement.is_trend else distance**2 - noise
        variance += 4.0 * distance**2 * noise + 2.0 * noise**2
    return Misfit(total, float(np.sqrt(variance)))


def _compute_tail_fourth_moment(z: float) -> float:
    """Return the mean fourth power of what lies below -z in a standard normal distribution."""
    if z > MAX_SIGMA:
        return 0.0
    from scipy.special import ndtr  # half a second, which every start of the workflow would take

    beyond = ndtr(-z)
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    polynomial = (z**4 + 6.0 * z**2 + 3.0) * beyond - (z**3 + 5.0 * z) * density
    return max(float(polynomial), 0.0)
