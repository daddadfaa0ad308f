"""Strata: rays with one random stream, for some wavelengths or some orders of scattering."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splits.kernels.base.scene import Optics, Scene
from splits.kernels.base.work import NO_MAX_ORDER
from splits.kernels.compiler.features import Features

STRATUM_BOUNDS = (-1.0, 0.0005, 0.0015, 0.004, 0.01, 0.03, 0.1)
"""Absorption over one mean distance between grains at which strata of wavelengths begin.  Visible
light needs few rays and long paths, the near infrared many rays and short paths."""
INITIAL_SEGMENTS = 400.0
"""Expected segments per ray, before tracing, of rays that little is absorbed of."""


@dataclass(eq=False)
class Stratum:
    """Rays with one random stream, for some node rows, or for some orders of scattering.

    Rays for strongly absorbed wavelengths only can be terminated early by roulette, and those for
    low orders of scattering after the last of these orders.

    Attributes
    ----------
    stream : int
        Number of the random streams.
    optics : Optics
    node_rows : slice
        Node rows that the rays serve.
    absorption : float, shape (node rows, columns)
        Their absorption coefficients (1/m).
    expected_segments : float
        Expected segments per ray before any was traced.
    max_order : int
        Largest order of scattering of a ray.
    features : Features or None
        Features of the vectorized kernel, None for the scalar kernel.
    n_rays, n_segments : int
        Traced so far.
    """

    stream: int
    optics: Optics
    node_rows: slice
    absorption: np.ndarray
    expected_segments: float = INITIAL_SEGMENTS
    max_order: int = NO_MAX_ORDER
    features: Features | None = None
    n_rays: int = 0
    n_segments: int = 0


def compute_absorption_per_mfp(scene: Scene, absorption: np.ndarray) -> np.ndarray:
    """Return the absorption over the smallest mean free path of a scene, by row.

    Parameters
    ----------
    scene : Scene
    absorption : float, shape (rows, columns)
        Absorption coefficients (1/m).
    """
    materials = np.arange(absorption.shape[1]) != scene.ground_column
    strength: np.ndarray = absorption[:, materials].max(axis=1)
    return strength / scene.layers.collision_coefficient.max()
