"""Interpolation of spectra of a table with their standard errors and interpolation errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from splits.core.validation import check_choice
from splits.tables.interpolation import (
    InterpolationWeights,
    compute_interpolation_weights,
)


class InterpolatedSpectra:
    """Values, standard errors and interpolation errors over the remaining axes."""

    def __init__(
        self, value: np.ndarray, stderr: np.ndarray, interpolation_error: np.ndarray | None = None
    ) -> None:
        self.value, self.stderr = value, stderr
        self.interpolation_error = (
            np.zeros_like(value) if interpolation_error is None else interpolation_error
        )


def compute_axis_weights(
    name: str, nodes: np.ndarray, axis_value: Any, *, has_direction: bool = False
) -> InterpolationWeights:
    """Return the interpolation weights of a position; a text value selects its node."""
    if nodes.dtype.kind == "f":
        return compute_interpolation_weights(name, nodes, axis_value, has_direction=has_direction)
    check_choice(name, str(axis_value), nodes.tolist())
    node = (nodes == str(axis_value)).argmax(keepdims=True)
    return InterpolationWeights(node, np.ones(1), node[:0], np.zeros((0, nodes.size)))


def interpolate_first_axis(
    spectra: InterpolatedSpectra, axis_weights: InterpolationWeights
) -> InterpolatedSpectra:
    """Interpolate spectra along the first axis."""
    stencil = [
        spectra.value[axis_weights.nodes],
        spectra.stderr[axis_weights.nodes],
        spectra.interpolation_error[axis_weights.nodes],
    ]
    value = np.tensordot(axis_weights.weights, stencil[0], 1)
    # Nodes share paths or random numbers, so their correlation is between 0 and 1.
    correlated = np.abs(np.tensordot(axis_weights.weights, stencil[1], 1))
    stderr = np.maximum(
        correlated, np.sqrt(np.tensordot(axis_weights.weights**2, stencil[1] ** 2, 1))
    )
    previous_error = np.tensordot(np.abs(axis_weights.weights), stencil[2], 1)
    estimates = np.abs(np.tensordot(axis_weights.error_weights, spectra.value, 1))
    axis_error = estimates.max(axis=0) if len(estimates) else np.zeros_like(value)
    return InterpolatedSpectra(value, stderr, np.hypot(previous_error, axis_error))


def interpolate_wavelengths(
    spectra: InterpolatedSpectra, nodes: np.ndarray, wavelengths: np.ndarray
) -> InterpolatedSpectra:
    """Interpolate spectra to other wavelengths."""
    points = [
        interpolate_first_axis(
            spectra, compute_interpolation_weights("wavelength", nodes, float(point))
        )
        for point in wavelengths
    ]
    value, stderr, interpolation_error = (
        np.array([getattr(point, name) for point in points])
        for name in ("value", "stderr", "interpolation_error")
    )
    return InterpolatedSpectra(value, stderr, interpolation_error)


def make_interpolated_variables(
    quantities: Sequence[str],
    labels: Sequence[str],
    spectra: Sequence[InterpolatedSpectra],
    dim: str = "wavelength",
) -> dict[str, Any]:
    """Return the variables of interpolated quantities, with their errors."""
    variables: dict[str, Any] = {}
    for name, label, spectrum in zip(quantities, labels, spectra, strict=True):
        stderr = np.hypot(spectrum.stderr, spectrum.interpolation_error)
        error_label = f"error of interpolation of {label}"
        variables |= {
            name: (dim, spectrum.value, {"long_name": label, "units": "1"}),
            f"{name}_stderr": (
                dim, stderr, {"long_name": f"standard error of {label}", "units": "1"},
            ),
            f"{name}_interpolation_error": (
                dim, spectrum.interpolation_error,
                {"long_name": error_label, "units": "1"},
            ),
        }  # fmt: skip
    return variables
