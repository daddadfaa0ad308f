"""Bounds on the error of interpolation between refractive indices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.media.medium import Interface

MAX_LOG_SLOPE = 0.3
MAX_LOG_CURVATURE = 0.25
"""Bounds on |df/d(ln x)| and |d²f/d(ln x)²| for f a reflectance, transmittance or absorptance and
x the mean contrast or the light that enters absorbing grains; `benchmarks/interpolation.py`
measures them for snow and sand."""
INTERFACE_WEIGHT = 0.5
"""Weight of a boundary in units of these bounds.  For its contrast c, external reflection changes
by at most 0.04 per d(ln c), internal reflection of diffuse light by 0.3, and the light that escapes
from a weakly absorbing sample by at most half of that."""
MIN_INTERFACE_CONTRAST = 0.25
"""Contrast of a boundary below which these bounds are proportional to it, as it reflects less."""
DENSE_SIDE_FACTOR = 2.0
"""Factor on `INTERFACE_WEIGHT` for light incident from the dense side: its reflection is total
above the critical angle."""
CONTRAST_KINK = 4.0 / 3.0
"""Half the change of slope where the contrast c of a boundary is 0: weak contrasts reflect c/3
of diffuse light from the thin side and 7c/3 from the dense one, and the sides change at 0."""
INTERPOLATION_FACTOR = 8.0
"""Relative error of a BRDF, or of a fraction near 0, in units of the bound for a fraction near 1/2.
It allows for elasticities up to 2.4; that of a single reflection is 4/(2 + c)."""
ABSORBING_K = 1e-3
"""Extinction coefficient at which a material counts half as absorbing: a grain of a tenth of a
millimetre then absorbs most of the visible light that enters it."""


def compute_contrasts(index: np.ndarray, interfaces: Sequence[Interface]) -> np.ndarray:
    """Return the contrasts of interfaces times their fractions, shape (wavelengths, interfaces)."""
    return _compute_weighted_contrasts(
        *_get_interface_indices(index, select_grain_interfaces(interfaces))
    )


def select_grain_interfaces(interfaces: Sequence[Interface]) -> list[Interface]:
    """Return the interfaces of grains, without the boundaries of layers."""
    return [interface for interface in interfaces if interface.location != "boundary"]


def _compute_weighted_contrasts(
    near: np.ndarray, far: np.ndarray, fraction: np.ndarray
) -> np.ndarray:
    # 2√F/(1 − √F) without the difference, which cancels for nearly perfect conductors.
    difference, total = np.abs(far - near), np.abs(far + near)
    magnitude = difference * (total + difference) / (2.0 * (far * near.conj()).real)
    return fraction * np.sign(far.real - near.real) * magnitude


def compute_entering_light(index: np.ndarray, interfaces: Sequence[Interface]) -> np.ndarray:
    """Return the light that enters absorbing grains, shape (wavelengths, interfaces).

    Interfaces within grains, and grains that hardly absorb at any wavelength, count as 0.
    """
    interfaces = select_grain_interfaces(interfaces)
    near, far, fraction = _get_interface_indices(index, interfaces)
    is_outer = np.array([i.location == "outer" for i in interfaces])
    k = far.imag.max(axis=0)
    entering = 1.0 - np.abs((far - near) / (far + near)) ** 2
    return is_outer * fraction * k / (k + ABSORBING_K) * entering


def _get_interface_indices(
    index: np.ndarray, interfaces: Sequence[Interface]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    near = index[:, [i.outer_material for i in interfaces]]
    far = index[:, [i.inner_material for i in interfaces]]
    return near, far, np.array([i.fraction for i in interfaces])


def bound_fraction_error(interpolation_bound: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return a bound on the interpolation error of a fraction of the light, or of a moment.

    Near 0 and 1 a fraction changes in proportion to its distance from there.
    """
    relative_slope = np.abs(INTERPOLATION_FACTOR * value * (1.0 - value))
    return interpolation_bound * np.clip(relative_slope, 0.0, 1.0)


def bound_derivative_error(interpolation_bound: np.ndarray, derivative: np.ndarray) -> np.ndarray:
    """Return a bound on the interpolation error of a derivative.

    Its relative error is that of light that is nearly all reflected or nearly all absorbed.
    """
    return np.clip(INTERPOLATION_FACTOR * interpolation_bound, 0.0, 1.0) * np.abs(derivative)


class Criterion(NamedTuple):
    """Criterion for the interpolation error of a layer.

    Attributes
    ----------
    weight : float
        Of the first- and second-order errors.
    values : float, shape (wavelengths, n)
    min_scale : float
        Scale below which changes are absolute instead of relative.
    kink : float
        Half the change of slope where the value, the only one, is 0.
    """

    weight: float
    values: np.ndarray
    min_scale: float = 0.0
    kink: float = 0.0


def make_criteria(index: np.ndarray, interfaces: Sequence[Interface]) -> list[Criterion]:
    """Return the criteria of a layer."""
    criteria = [
        Criterion(1.0, compute_contrasts(index, interfaces)),
        Criterion(1.0, compute_entering_light(index, interfaces)),
    ]
    for boundary in (interface for interface in interfaces if interface.location == "boundary"):
        near, far, fraction = _get_interface_indices(index, [boundary])
        values = _compute_weighted_contrasts(near, far, np.ones_like(fraction))
        weight, kink = INTERFACE_WEIGHT * boundary.fraction, CONTRAST_KINK * boundary.fraction
        if (values < 0.0).any():
            weight *= DENSE_SIDE_FACTOR
        criteria.append(Criterion(weight, values, MIN_INTERFACE_CONTRAST, kink))
    return criteria


def project_on_chord(u: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the weight of a in the convex combination of a and b nearest to each row of u."""
    along = a - b
    square = along @ along
    if square == 0.0:
        return np.ones(len(u))
    return np.clip((u - b) @ along / square, 0.0, 1.0)


def bound_smooth_error(criterion: Criterion, first: int, second: int, t: np.ndarray) -> np.ndarray:
    """Return a bound on |t·f(a) + (1 − t)·f(b) − f(u)| for every row u, of two rows a and b.

    The first order is `MAX_LOG_SLOPE` times the relative distance of u from the chord; the second,
    the gap of Jensen's inequality, `MAX_LOG_CURVATURE`/2 times the mean square of the relative
    distances from both ends.
    """
    u, a, b = criterion.values, criterion.values[first], criterion.values[second]
    size = np.abs(u).sum(axis=1)

    def compute_relative_distance(distance: np.ndarray, other: np.ndarray | float) -> np.ndarray:
        scale = np.maximum(np.minimum(size, other), criterion.min_scale)
        is_positive = distance > 0.0
        relative = np.where(is_positive, np.inf, 0.0)
        return np.divide(distance, scale, out=relative, where=is_positive & (scale > 0.0))

    chord = t[:, np.newaxis] * a + (1.0 - t)[:, np.newaxis] * b
    chord_distance = compute_relative_distance(np.abs(chord - u).sum(axis=1), np.inf)
    total = MAX_LOG_SLOPE * chord_distance
    for end, weight in ((a, t), (b, 1.0 - t)):
        end_distance = compute_relative_distance(np.abs(end - u).sum(axis=1), np.abs(end).sum())
        gap = np.multiply(weight, end_distance**2, out=np.zeros(len(u)), where=weight > 0.0)
        total += 0.5 * MAX_LOG_CURVATURE * gap
    return total


def bound_kink_error(criterion: Criterion, first: int, second: int, t: np.ndarray) -> np.ndarray:
    """Return the additional bound for a kink at 0: nothing, if all values have one sign."""
    if criterion.kink == 0.0:
        return np.zeros(len(t))
    a, b = criterion.values[first], criterion.values[second]
    chord = t[:, np.newaxis] * a + (1.0 - t)[:, np.newaxis] * b
    end_gap = t * np.abs(a).sum() + (1.0 - t) * np.abs(b).sum() - np.abs(chord).sum(axis=1)
    crossed = np.sign(chord) * np.sign(criterion.values) < 0.0
    overlap = np.minimum(np.abs(chord), np.abs(criterion.values))
    overshoot = np.where(crossed, overlap, 0.0).sum(axis=1)
    return criterion.kink * (np.maximum(end_gap, 0.0) + 2.0 * overshoot)
