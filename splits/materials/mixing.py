"""Complex refractive index of a matrix with small inclusions of another material."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from splits.core.arrays import as_float_array
from splits.core.validation import invalid, snap_to_limits


def _check_arguments(matrix: Any, inclusion: Any, fraction: Any) -> tuple[np.ndarray, ...]:
    volume_fraction = snap_to_limits(
        as_float_array("fraction", fraction, allow_gaps=True), 0.0, 1.0
    )
    outside = volume_fraction[~((volume_fraction >= 0.0) & (volume_fraction <= 1.0))]
    if outside.size:
        raise invalid("fraction", float(outside.flat[0]), "in [0, 1]")
    return np.asarray(matrix, dtype=complex), np.asarray(inclusion, dtype=complex), volume_fraction


def maxwell_garnett(matrix: Any, inclusion: Any, fraction: Any) -> np.ndarray:
    """Return the effective refractive index of small spheres in a matrix (Maxwell Garnett).

    With dielectric constants ε = m², ε = ε_m (ε_i + 2ε_m + 2f (ε_i − ε_m)) /
    (ε_i + 2ε_m − f (ε_i − ε_m)); the index is the root with n > 0 and k ≥ 0.  The spheres are small
    compared to the wavelength.

    Parameters
    ----------
    matrix, inclusion : complex array_like
        Refractive indices n + i k with n > 0, k ≥ 0.
    fraction : array_like
        Volume of the inclusions per volume of the mixture, 0 to 1.  All three broadcast.

    Raises
    ------
    ValueError
        For a fraction outside [0, 1].

    References
    ----------
    SPLITS (Kimmel & Baranoski 2007) section 4.2.4 Eq 4; Maxwell Garnett 1904, Philosophical
    Transactions of the Royal Society A 203, 385-420.
    """
    m, i, f = _check_arguments(matrix, inclusion, fraction)
    outer, inner = m * m, i * i
    contrast, total = (i - m) * (i + m), inner + 2.0 * outer
    # The formula above, written as the distance from the nearer pure material, so that k of the
    # mixture keeps its digits even if all absorption is due to a trace of one material.
    scale = contrast / (total - f * contrast)
    epsilon = np.where(f < 0.5, outer + 3.0 * f * outer * scale, inner - (1.0 - f) * total * scale)
    root = np.sqrt(epsilon)
    # Rounding may make k slightly negative where neither material absorbs.
    mixture = root.real + 1j * np.maximum(root.imag, 0.0)
    return np.where(f == 0.0, m, np.where(f == 1.0, i, mixture))


def linear_mixing(matrix: Any, inclusion: Any, fraction: Any) -> np.ndarray:
    """Return the volume-weighted mean of two refractive indices.

    Parameters
    ----------
    matrix, inclusion : complex array_like
        Refractive indices n + i k.
    fraction : array_like
        Volume of the inclusions per volume of the mixture, 0 to 1.  All three broadcast.

    Raises
    ------
    ValueError
        For a fraction outside [0, 1].
    """
    m, i, f = _check_arguments(matrix, inclusion, fraction)
    return (1.0 - f) * m + f * i


MIXING_RULES: Mapping[str, Callable[[Any, Any, Any], np.ndarray]] = MappingProxyType(
    {"maxwell_garnett": maxwell_garnett, "linear": linear_mixing}
)
"""Mixing rules by name."""
