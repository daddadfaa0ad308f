"""How what was found goes with what is known: a line through the origin."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Proportion(NamedTuple):
    """A line y = a x through points that count alike.

    Attributes
    ----------
    slope, stderr : float
        a, and its standard error by the scatter.
    scatter : float
        Standard deviation of y about the line.
    """

    slope: float
    stderr: float
    scatter: float


def proportion(x: np.ndarray, y: np.ndarray) -> Proportion:
    """Return the line through the origin that comes nearest to points.

    Parameters
    ----------
    x, y : float, shape (points,)
        Two points or more.
    """
    square = float((x * x).sum())
    slope = float((x * y).sum() / square)
    scatter = float(np.sqrt(np.sum((y - slope * x) ** 2) / (len(x) - 1)))
    return Proportion(slope, scatter / float(np.sqrt(square)), scatter)
