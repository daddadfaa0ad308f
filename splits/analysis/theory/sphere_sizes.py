"""Size distributions of spheres, and sums of Mie scattering over them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from splits.analysis.theory.sphere_sums import AngularFunctions, SphereSums, sum_spheres
from splits.core.arrays import (
    align_to_labels,
    as_1d_array,
    check_array_range,
    check_increasing,
    find_labels,
)
from splits.core.validation import check_range, invalid

RADIUS_RANGE_UM = (1e-4, 1e5)
VARIANCE_RANGE = (1e-3, 0.499)
EXCLUDED_FRACTION = 1e-7
"""Fraction of a gamma distribution that is left out at each of its ends."""
MIN_INTERVALS, MAX_INTERVALS = 64, 65536
"""Smallest and largest number of intervals of the quadrature over a gamma distribution."""


@dataclass(frozen=True)
class GivenSizes:
    """Spheres of given radii.

    Attributes
    ----------
    radius_um : float, shape (radii,)
        Increasing.
    number : float, shape (radii,)
        Numbers of spheres, at least one of them above 0.
    """

    radius_um: np.ndarray
    number: np.ndarray

    @classmethod
    def from_input(cls, radius_um: Any, number_density: Any) -> GivenSizes:
        """Return sizes from the arguments of a user; None counts every radius once."""
        radius = as_1d_array("radius_um", radius_um, "numbers in micrometres")
        check_increasing("radius_um", radius)
        check_array_range("radius_um", radius, *RADIUS_RANGE_UM, "um")
        if number_density is None:
            if radius.size > 1:
                raise invalid("number_density", None, "given for several radii")
            return cls(radius, np.ones(1))
        number = np.atleast_1d(
            align_to_labels("number_density", number_density, radius, find_labels(radius_um))
        )
        check_array_range("number_density", number, 0.0, np.inf)
        if number.shape != radius.shape or not number.any():
            allowed = f"{radius.size} numbers, one for each radius, not all of them 0"
            raise invalid("number_density", number.tolist(), allowed)
        return cls(radius, number)

    @property
    def largest_um(self) -> float:
        """Largest radius (µm)."""
        return float(self.radius_um[-1])

    def sum_spheres(
        self, index: complex, size_per_um: float, functions: AngularFunctions
    ) -> tuple[SphereSums, int]:
        """Return sums over the spheres, and the number of radii; see `GammaSizes.sum_spheres`."""
        area = self.number * self.radius_um**2
        return sum_spheres(index, size_per_um * self.radius_um, area, functions), area.size

    def describe(self) -> dict[str, Any]:
        """Return the attributes of a dataset."""
        return {"radius_um": self.radius_um, "number_density": self.number}


@dataclass(frozen=True)
class GammaSizes:
    """Gamma distribution n(r) ∝ r^((1 − 3b)/b) exp(−r/(ab)), Hansen & Travis (1974), Eq 2.56.

    Projected area r² n(r) has a gamma distribution of the shape 1/b and the mean a.

    Attributes
    ----------
    effective_radius_um : float
        Effective radius a.
    effective_variance : float
        Effective variance b.
    tolerance : float
        Change of the means at which the quadrature ends.
    """

    effective_radius_um: float
    effective_variance: float
    tolerance: float

    @classmethod
    def from_input(cls, radius: Any, variance: Any, tolerance: float) -> GammaSizes:
        """Return sizes from the arguments of a user."""
        for key, value in (("effective_radius_um", radius), ("effective_variance", variance)):
            if value is None:
                raise invalid(key, None, "given, as the other one is")
        return cls(
            check_range("effective_radius_um", radius, *RADIUS_RANGE_UM, "um"),
            check_range("effective_variance", variance, *VARIANCE_RANGE),
            tolerance,
        )

    @property
    def relative_limits(self) -> tuple[float, float]:
        """Smallest and largest radius of the quadrature, divided by the effective radius.

        They exclude `EXCLUDED_FRACTION` of the area of the smallest spheres, and of the squared
        area, to which the light that is scattered straight ahead is proportional, of the largest.
        """
        from scipy.special import gammainccinv, gammaincinv

        shape = 1.0 / self.effective_variance
        low = gammaincinv(shape, EXCLUDED_FRACTION)
        high = gammainccinv(shape + 2.0, EXCLUDED_FRACTION)
        return float(low) / shape, float(high) / shape

    @property
    def largest_um(self) -> float:
        """Largest radius of the quadrature (µm)."""
        return self.effective_radius_um * self.relative_limits[1]

    def sum_spheres(
        self, index: complex, size_per_um: float, functions: AngularFunctions
    ) -> tuple[SphereSums, int]:
        """Return sums over the distribution, and the number of radii.

        The trapezoidal rule converges faster than any power of its interval for smooth functions
        that vanish at both ends.  Its intervals are halved until the means change by at most the
        tolerance.

        Parameters
        ----------
        index : complex
            Refractive index relative to the surrounding medium.
        size_per_um : float
            Size parameter per radius (1/µm).
        functions : AngularFunctions

        Raises
        ------
        ValueError
            If more than `MAX_INTERVALS` intervals are needed.
        """
        low, high = self.relative_limits

        def sum_at(fraction: np.ndarray) -> SphereSums:
            """Return the sums at fractions of the range of radii."""
            radius = low + (high - low) * fraction
            # The exponential is 1 at the effective radius and does not underflow.
            exponent = (np.log(radius) + 1.0 - radius) / self.effective_variance
            area = np.exp(exponent) / radius
            size = size_per_um * self.effective_radius_um * radius
            return sum_spheres(index, size, area, functions)

        intervals = MIN_INTERVALS
        sums = sum_at(np.arange(intervals + 1) / intervals)
        while intervals < MAX_INTERVALS:
            finer = sums.add(sum_at((np.arange(intervals) + 0.5) / intervals))
            intervals *= 2
            if finer.measure_change(sums) <= self.tolerance:
                return finer, intervals + 1
            sums = finer
        hint = "or a larger effective_variance, smaller spheres"
        allowed = f"one that {MAX_INTERVALS + 1} radii reach"
        raise invalid("tolerance", self.tolerance, allowed, hint)

    def describe(self) -> dict[str, Any]:
        """Return the attributes of a dataset."""
        return {
            "effective_radius_um": self.effective_radius_um,
            "effective_variance": self.effective_variance,
            "tolerance": self.tolerance,
        }
