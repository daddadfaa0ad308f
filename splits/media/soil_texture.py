"""Particle size distribution of soils: a log-normal distribution per soil separate, from texture.

SPLITS section 4.2.6 follows Shirazi et al. (1988, Soil Science Society of America Journal 52,
181-190): within clay, silt and sand the distribution of mass is log-normal.  The geometric mean
and standard deviation of each separate follow from the cumulative mass at its two limits, taken as
points of a normal distribution in log size.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from statistics import NormalDist

import numpy as np

from splits.core.arrays import check_named_numbers
from splits.core.validation import check_range, invalid
from splits.kernels.rng import make_table_probabilities
from splits.media.grain_statistics import N_TABLE_POINTS, integrate_with_quantiles

SEPARATE_LIMITS_M = (5e-8, 2e-6, 5e-5, 2e-3)
"""Limits of clay, silt and sand (m): USDA, with 50 nm as the smallest clay particle."""
SOIL_SEPARATES = ("clay", "silt", "sand")
MAX_FINES_FRACTION = 0.15
"""Maximum of silt + 1.5 clay in a sand (USDA; SPLITS Table 2)."""


@dataclass(frozen=True)
class TruncatedLogNormal:
    """Mass distribution of a soil separate: log-normal between two sizes.

    Attributes
    ----------
    min_size_m, max_size_m : float
        Limits of the major axis (m).
    mass_fraction : float
        Mass per mass of all particles.
    log_mean, log_sd : float
        Mean and standard deviation of the natural logarithm of the size in m: a_g, b_g of Eq 19.
    """

    min_size_m: float
    max_size_m: float
    mass_fraction: float
    log_mean: float
    log_sd: float

    def _relative_density(self, x: np.ndarray, power: float = 0.0) -> np.ndarray:
        """Return s^power times the probability density of x = ln s, up to a factor."""
        score = (x - self.log_mean) / self.log_sd
        return np.exp(-0.5 * score**2 + power * (x - np.log(self.min_size_m)))

    @property
    def mean_inverse_size_per_m(self) -> float:
        """Mass-weighted mean of 1/s (1/m): the quotient of integrals in Eq 23."""
        return _compute_mean_inverse_size(self)

    def compute_hit_sizes(self, probability: np.ndarray) -> np.ndarray:
        """Return quantiles of the size of hit particles (m): density ∝ s⁻² f_g(s), Eq 25."""
        low, high = float(np.log(self.min_size_m)), float(np.log(self.max_size_m))
        return np.exp(
            integrate_with_quantiles(
                lambda x: self._relative_density(x, -1.0), low, high, probability
            )[1]
        )


@lru_cache(maxsize=1024)
def _compute_mean_inverse_size(distribution: TruncatedLogNormal) -> float:
    """Return `TruncatedLogNormal.mean_inverse_size_per_m`, cached for repeated use in fits."""
    # The closed form is not used: its error functions cancel when the limits of a separate lie
    # close together in probability, while this integrand is always smooth.
    low, high = float(np.log(distribution.min_size_m)), float(np.log(distribution.max_size_m))
    weighted, _ = integrate_with_quantiles(
        lambda x: distribution._relative_density(x, -1.0), low, high
    )
    return (
        weighted
        / integrate_with_quantiles(distribution._relative_density, low, high)[0]
        / distribution.min_size_m
    )


@dataclass(frozen=True)
class SoilSizeDistribution:
    """Particle size distribution of a soil, by separate from fine to coarse."""

    separates: tuple[TruncatedLogNormal, ...]

    @property
    def largest_m(self) -> float:
        """Largest major axis (m)."""
        return max(s.max_size_m for s in self.separates)

    @property
    def size_attenuation_per_m(self) -> float:
        """Volume-weighted mean of 1/s (1/m): K1 of Eq 23 without v_j."""
        return sum(s.mass_fraction * s.mean_inverse_size_per_m for s in self.separates)

    def tabulate_hit_inverse_sizes(self) -> np.ndarray:
        """Return the quantile function of 1/s of hit particles, shape (N_TABLE_POINTS,).

        The table is linear between the outermost quantiles of two separates, as within one.  For
        clay and sand without silt, about 0.1 % of the particles that are hit fall in the gap.
        """
        return _tabulate_hit_inverse_sizes(self).copy()


@lru_cache(maxsize=64)
def _tabulate_hit_inverse_sizes(distribution: SoilSizeDistribution) -> np.ndarray:
    u = make_table_probabilities(N_TABLE_POINTS)
    weights = np.array(
        [s.mass_fraction * s.mean_inverse_size_per_m for s in distribution.separates]
    )[::-1]
    edges = np.concatenate([[0.0], np.cumsum(weights) / weights.sum()])
    edges[-1] = 1.0
    inverse_size = np.empty(u.shape)
    for i, separate in enumerate(reversed(distribution.separates)):
        inside = (u >= edges[i]) & (u <= edges[i + 1])
        fraction = (u[inside] - edges[i]) / (edges[i + 1] - edges[i])
        inverse_size[inside] = 1.0 / separate.compute_hit_sizes(1.0 - fraction)
    return inverse_size


def make_size_distribution(
    texture: object, tail_mass: float = 1e-4, size_model: str = "separates"
) -> SoilSizeDistribution:
    """Return the particle size distribution of a sand of given texture.

    Parameters
    ----------
    texture : (clay, silt, sand)
        Mass fractions ζ1, ζ2, ζ3, adding up to 1, with ζ2 + 1.5 ζ1 at most 0.15.
    tail_mass : float
        Mass fraction assumed outside the outermost limits, 1e-6 to 0.01.  It determines how far
        the distributions of the outermost separates extend towards small sizes.
    size_model : {"separates", "single"}
        A log-normal distribution per separate, or a single one with the geometric mean and
        standard deviation of the texture (Shirazi & Boersma 1984, Soil Science Society of America
        Journal 48, 142-147), between the limits of the separates present.

    Raises
    ------
    ValueError
        For a texture that is not that of a sand.
    """
    clay, silt, sand = check_named_numbers("texture", texture, SOIL_SEPARATES, (0.0, 1.0))
    if min(clay, silt, sand) < 0.0 or abs(clay + silt + sand - 1.0) > 1e-9:
        raise invalid("texture", texture, "three fractions (clay, silt, sand) that add up to 1")
    if silt + 1.5 * clay > MAX_FINES_FRACTION + 1e-9:
        raise invalid(
            "texture",
            texture,
            f"silt + 1.5 clay at most {MAX_FINES_FRACTION:g}",
            "more is not a sand",
        )
    tail_mass = check_range("size_tail", tail_mass, 1e-6, 0.01)
    cumulative = np.clip(
        [tail_mass, clay, clay + silt, 1.0 - tail_mass], tail_mass, 1.0 - tail_mass
    )
    score = [NormalDist().inv_cdf(c) for c in cumulative]
    x = np.log(SEPARATE_LIMITS_M)
    if size_model == "single":
        return SoilSizeDistribution((_make_single_log_normal((clay, silt, sand)),))
    separates = []
    for i, mass in enumerate((clay, silt, sand)):
        if mass > 0.0 and score[i + 1] > score[i]:
            sd = (x[i + 1] - x[i]) / (score[i + 1] - score[i])
            mean = x[i] - sd * score[i]
            separates.append(
                TruncatedLogNormal(
                    SEPARATE_LIMITS_M[i], SEPARATE_LIMITS_M[i + 1], mass, float(mean), float(sd)
                )
            )
    total = sum(s.mass_fraction for s in separates)
    return SoilSizeDistribution(
        tuple(
            TruncatedLogNormal(
                s.min_size_m, s.max_size_m, s.mass_fraction / total, s.log_mean, s.log_sd
            )
            for s in separates
        )
    )


def _make_single_log_normal(texture: tuple[float, float, float]) -> TruncatedLogNormal:
    """Return a single log-normal distribution, from the midpoints of the separates."""
    mass = np.array(texture)
    log_midpoint = np.log([0.5 * (a + b) for a, b in pairwise((0.0, *SEPARATE_LIMITS_M[1:]))])
    mean = float(mass @ log_midpoint)
    sd = float(np.sqrt(max(mass @ log_midpoint**2 - mean**2, 0.0)))
    present = np.flatnonzero(mass)
    low, high = SEPARATE_LIMITS_M[present[0]], SEPARATE_LIMITS_M[present[-1] + 1]
    if present.size == 1:
        raise invalid(
            "interpretation.size_distribution", "single",
            "'separates' for a texture of one separate alone",
            "its standard deviation would be zero",
        )  # fmt: skip
    return TruncatedLogNormal(low, high, 1.0, mean, sd)
