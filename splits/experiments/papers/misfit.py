"""Misfit of a model to the statements of a paper.

A stated number has a tolerance: the largest difference that counts as agreement.  The misfit of a
set of statements is the sum of squared differences in units of the tolerances.  Qualitative trends
add to it only where they fail.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

TREND_TOLERANCE = 0.1
"""Tolerance of a trend, relative to the compared quantity (nadir BRDF, height of a peak)."""

MAX_SIGMA = 8.0
"""Significance (standard errors) above which the variance of a satisfied trend is set to 0, because
its formula loses all digits."""


@dataclass(frozen=True)
class PublishedStatement:
    """A number or trend that a paper states.

    Attributes
    ----------
    name, place : str
        Its id, and its place in the paper.
    published : float
        The number, or 0 for a trend, which is satisfied by positive values.
    tolerance : float
        Above 0.
    is_trend : bool
        Whether only values below `published` add to the misfit.
    """

    name: str
    place: str
    published: float
    tolerance: float
    is_trend: bool = False

    def normalize_difference(self, ours: np.ndarray | float) -> np.ndarray:
        """Return the signed difference in units of the tolerance; 0 for a satisfied trend."""
        difference = (np.asarray(ours, dtype=float) - self.published) / self.tolerance
        return np.minimum(difference, 0.0) if self.is_trend else difference


def select_statements(
    published: pd.DataFrame, names: Iterable[str]
) -> dict[str, PublishedStatement]:
    """Return statements of numbers by name.

    Parameters
    ----------
    published : pandas.DataFrame
        See `splits.analysis.measured.read_published`.  Where limits are given instead of a
        tolerance, half of their distance is the tolerance.
    names : iterable of str
        Ids in that table.
    """
    statements = {}
    for name in names:
        row = published.loc[name]
        if isinstance(row.bar, str):
            unit = abs(row.published) / 100.0 if row.bar.endswith("%") else 1.0
            tolerance = float(row.bar.rstrip("%")) * unit
        else:
            tolerance = 0.5 * (float(row.high) - float(row.low))
        statements[name] = PublishedStatement(name, str(row.place), float(row.published), tolerance)
    return statements


@dataclass(frozen=True)
class Misfit:
    """Sum of squared differences in units of the tolerances.

    Attributes
    ----------
    total : float
        Sum with the mean contribution of noise subtracted.
    stderr : float
    """

    total: float
    stderr: float

    def compute_rms(self, n_statements: int) -> tuple[float, float]:
        """Return the root-mean-square difference in tolerances per statement, and its error."""
        value = float(np.sqrt(max(self.total, 0.0) / n_statements))
        spread = self.stderr / n_statements
        return value, float(spread / (2.0 * value)) if value > 0.0 else float(np.sqrt(spread))


def compute_misfit(
    statements: Iterable[PublishedStatement], ours: Iterable[float], stderr: Iterable[float]
) -> Misfit:
    """Return the misfit of values with independent errors.

    With a difference d of error e (both in tolerances), d² is e² too large on average and has the
    variance 4 d² e² + 2 e⁴.  A trend that fails is treated alike.  A trend that is satisfied by z
    standard errors adds only to the variance, for the probability that the true value fails:
    e⁴ ((z⁴ + 6z² + 3) Φ(−z) − (z³ + 5z) φ(z)).
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
    """Return the fourth moment of a standard normal distribution beyond -z, about -z."""
    if z > MAX_SIGMA:
        return 0.0
    from scipy.special import ndtr  # imported here, as it would slow the start of the workflow

    tail = ndtr(-z)
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    polynomial = (z**4 + 6.0 * z**2 + 3.0) * tail - (z**3 + 5.0 * z) * density
    return max(float(polynomial), 0.0)
