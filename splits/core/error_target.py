"""What the requested error of an angular distribution applies to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

MIN_REFERENCE_FRACTION = 0.05
"""Fraction of an isotropic distribution below which the error is relative to that fraction."""


class ErrorTarget(NamedTuple):
    """What the requested error of a BRDF or BTDF applies to.

    Attributes
    ----------
    side : int
        0 reflected, 1 transmitted.
    direction_mask : bool, shape (directions,)
    absolute : bool
        Whether the error is that of the reflectance factor, instead of a relative one.
    """

    side: int
    direction_mask: np.ndarray
    absolute: bool = False

    def compute_reference(self, values: np.ndarray, scattered: np.ndarray) -> np.ndarray:
        """Return what errors of a BRDF or BTDF are divided by (1/sr), in the shape of the values.

        It is the value, or 1/20 of that of an isotropic distribution, whichever is larger; for
        absolute errors, the BRDF of a perfect diffuser.

        Parameters
        ----------
        values : float, shape (..., directions)
            1/sr.
        scattered : float, shape (...)
            Reflectance or transmittance of scattered light.
        """
        if self.absolute:
            return np.full_like(values, 1.0 / np.pi)
        isotropic = np.expand_dims(scattered, -1) / np.pi
        return np.maximum(values, MIN_REFERENCE_FRACTION * isotropic)
