"""Rough surfaces used by several tests, and their heights in plain NumPy."""

import numpy as np

from splits.kernels.rough_surface.realization import (
    AMPLITUDE,
    KX,
    KY,
    PHASE,
    make_realization,
)
from splits.media.rough_surface import RoughSurface

GAUSSIAN = {"rms_height_m": 0.5, "wave_number_per_m": 1.0, "correlation": "gaussian", "waves": 16}
EXPONENTIAL = {"rms_height_m": 0.2, "wave_number_per_m": 1.0, "band_limit_per_m": 50.0}
TABULATED = {"rms_height_m": 2.0, "wave_number_per_m": 0.1, "correlation": "exponential_printed"}
TABLE = {"wave_number_per_m": [0.5, 1.0, 2.0], "density": [1.0, 2.0, 0.0]}
SPECTRUM = {"rms_height_m": 0.3, "correlation": "spectrum", "spectrum": TABLE}
SURFACES = {
    "gaussian": GAUSSIAN,
    "exponential": EXPONENTIAL,
    "printed": TABULATED,
    "spectrum": SPECTRUM,
    "two scales": [TABULATED, GAUSSIAN | {"rms_height_m": 0.05, "wave_number_per_m": 20.0}],
}


def draw_realization(surface, index=0):
    """Return one realization of a rough surface."""
    realization = make_realization(RoughSurface.from_input(surface).sample_realization(7, index))
    assert realization.max_height > 0.0
    return realization


def sum_waves(waves, x, y):
    """Return the heights of a sum of waves, computed with NumPy."""
    phase = np.multiply.outer(waves[KX], x) + np.multiply.outer(waves[KY], y)
    return np.tensordot(waves[AMPLITUDE], np.cos(2.0 * np.pi * (phase.T - waves[PHASE]).T), axes=1)
