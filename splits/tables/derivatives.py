"""Derivatives of tabulated quantities with respect to the parameters of the axes.

They are the derivatives of the interpolating polynomials of `splits.tables.interpolation`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.validation import invalid, unknown_key
from splits.media.parameters import get_derivative_unit
from splits.tables.interpolation import InterpolationWeights, apply_axis_transform, transform_axis

_TINY = 1e-300


class DerivativeWeights(NamedTuple):
    """Weights of the nodes of an axis in a derivative, for the full stencil and one node fewer."""

    weights: np.ndarray
    lower_order_weights: np.ndarray


class DerivativeEstimate(NamedTuple):
    """Spectral derivative with its standard error from the nodes and its interpolation error."""

    value: np.ndarray
    stderr: np.ndarray
    interpolation_error: np.ndarray


def compute_derivative_weights(
    name: str, nodes: np.ndarray, stencil: np.ndarray, value: float, *, has_direction: bool = False
) -> DerivativeWeights:
    """Return the weights of the derivative with respect to the parameter of an axis.

    Parameters
    ----------
    name : str
        Name of the axis.
    nodes : float, shape (nodes,)
        Nodes of the axis.
    stencil : int, shape (stencil,)
        Indices of the nodes to use, at least 2.
    value : float
        Position on the axis.
    has_direction : bool
        See `splits.tables.interpolation.transform_axis`.

    Raises
    ------
    ValueError
        For an axis of one node, or at the singularity of a square-root transform.
    """
    if len(stencil) < 2:
        raise invalid(f"derivatives ({name})", len(nodes), "an axis of at least two nodes")
    kind, coordinates = transform_axis(name, nodes, has_direction=has_direction)
    x = float(apply_axis_transform(kind, np.array(value)))
    if kind == "square_root" and value <= _TINY:
        hint = "reflectance varies as a square root there: use a larger value"
        raise invalid(f"derivatives ({name})", value, "where the derivative is finite", hint)
    rate = {
        "logarithm": lambda: 1.0 / value, "square_root": lambda: 0.5 / x, "identity": lambda: 1.0,
        "cosine": lambda: float(np.radians(1.0) * np.sin(np.radians(value))),
    }[kind]()  # fmt: skip
    derivative_weights = rate * _compute_lagrange_derivatives(coordinates[stencil], x)
    lower_order = derivative_weights.copy()
    if len(stencil) > 2:
        farthest = int(np.argmax(np.abs(coordinates[stencil] - x)))
        kept = np.delete(np.arange(len(stencil)), farthest)
        lower_order = np.zeros_like(derivative_weights)
        lower_order[kept] = rate * _compute_lagrange_derivatives(coordinates[stencil][kept], x)
    return DerivativeWeights(derivative_weights, lower_order)


def differentiate(
    part: xr.Dataset,
    quantity: str,
    weights: Sequence[InterpolationWeights],
    axis: int,
    derivative_weights: DerivativeWeights,
) -> DerivativeEstimate:
    """Return the derivative along one axis at a point.

    Parameters
    ----------
    part : xarray.Dataset
        Nodes around the point, with axes in the order of `weights` and the wavelength last.
    quantity : str
    weights : sequence of InterpolationWeights
        Interpolation weights of every axis.
    axis : int
        Axis of the derivative.
    derivative_weights : DerivativeWeights
        Weights of the derivative along that axis.
    """
    values = part[quantity].values.astype(float)
    value_weights = [w.weights for w in weights]
    axis_weights = [*value_weights[:axis], derivative_weights.weights, *value_weights[axis + 1 :]]
    lower_order_weights = [
        *value_weights[:axis],
        derivative_weights.lower_order_weights,
        *value_weights[axis + 1 :],
    ]
    value = _apply_weights(values, weights, axis_weights)
    squared_error = (value - _apply_weights(values, weights, lower_order_weights)) ** 2
    for i, w in enumerate(weights):
        if i != axis and len(w.error_weights):
            squared_error = squared_error + max(
                (
                    _apply_full_axis_weights(values, weights, axis_weights, i, row) ** 2
                    for row in w.error_weights
                ),
                key=lambda estimate: float(estimate.sum()),
            )
    batch_variable = f"{quantity}_batches"
    error = part[f"{quantity}_stderr"].values.astype(float)
    variance = _apply_weights(error**2, weights, [s**2 for s in axis_weights])
    if batch_variable in part:
        dims = [d for d in part[quantity].dims if d != "wavelength"]
        deviations = (
            part[batch_variable].transpose(*dims, "batch", "wavelength").values.astype(float)
        )
        variance = (_apply_weights(deviations, weights, axis_weights) ** 2).sum(axis=0)
    return DerivativeEstimate(value, np.sqrt(variance), np.sqrt(squared_error))


def make_derivative_dataset(
    estimates: dict[str, list[DerivativeEstimate]],
    names: Sequence[str],
    wavelength: Any,
    attrs: dict[str, Any],
) -> xr.Dataset:
    """Return derivatives of each quantity over ``parameter`` and ``wavelength``."""
    dims = ("parameter", "wavelength")
    variables = {}
    for quantity, rows in estimates.items():
        label = f"derivative of {quantity} with respect to the parameter, per unit of it"
        stderr = [np.hypot(row.stderr, row.interpolation_error) for row in rows]
        for suffix, values, long_name in (
            ("", [row.value for row in rows], label),
            ("_stderr", stderr, f"standard error of the {label}"),
        ):
            variable_attrs = {"long_name": long_name, "units": "1"}
            variables[f"{quantity}_jacobian{suffix}"] = (dims, np.stack(values), variable_attrs)
    units = [get_derivative_unit(name) for name in names]
    axes = {
        "parameter": ("parameter", list(names), {"long_name": "parameter"}),
        "parameter_unit": ("parameter", units, {"long_name": "unit of the derivative"}),
        "wavelength": wavelength,
    }
    return xr.Dataset(variables, axes, attrs)


def check_derivative_axes(names: Any, axes: Sequence[str]) -> list[str]:
    """Return the validated axes of derivatives."""
    if isinstance(names, str) or not isinstance(names, Sequence) or not names:
        raise invalid("names", names, f"a list of {', '.join(axes)}")
    for name in names:
        if name not in axes:
            raise unknown_key(f"names.{name}", axes)
    if len(set(names)) < len(names):
        raise invalid("names", list(names), "different names")
    return list(names)


def _apply_weights(
    values: np.ndarray, weights: Sequence[InterpolationWeights], axis_weights: Sequence[np.ndarray]
) -> np.ndarray:
    """Return the weighted sum over the stencils of all axes."""
    for w, axis_weight in zip(weights, axis_weights, strict=True):
        values = np.tensordot(axis_weight, values[w.nodes], 1)
    return values


def _apply_full_axis_weights(
    values: np.ndarray,
    weights: Sequence[InterpolationWeights],
    axis_weights: Sequence[np.ndarray],
    axis: int,
    full_weights: np.ndarray,
) -> np.ndarray:
    """Return the weighted sum with weights of all nodes along one axis."""
    for i, (w, axis_weight) in enumerate(zip(weights, axis_weights, strict=True)):
        values = np.tensordot(full_weights if i == axis else axis_weight,
                              values if i == axis else values[w.nodes], 1)  # fmt: skip
    return values


def _compute_lagrange_derivatives(nodes: np.ndarray, x: float) -> np.ndarray:
    """Return the weights of the derivative of the Lagrange polynomial at x."""
    weights = np.zeros(len(nodes))
    for i, node in enumerate(nodes):
        for omitted in range(len(nodes)):
            if omitted == i:
                continue
            term = 1.0 / (node - nodes[omitted])
            for j, other_node in enumerate(nodes):
                if j not in (i, omitted):
                    term *= (x - other_node) / (node - other_node)
            weights[i] += term
    return weights
