"""Derivatives of a table's light to the parameters along its axes, between nodes.

They are those of the polynomials that values are drawn from, see `splits.tables.interpolation`.
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
    """Weights of the nodes of an axis in a derivative, those of one node fewer beside."""

    weights: np.ndarray
    lower_order_weights: np.ndarray


class DerivativeEstimate(NamedTuple):
    """A derivative along the spectrum, its error by the cells, and what reading between misses."""

    value: np.ndarray
    stderr: np.ndarray
    interpolation_error: np.ndarray


def compute_derivative_weights(
    name: str, nodes: np.ndarray, stencil: np.ndarray, value: float
) -> DerivativeWeights:
    """Return how the derivative to a parameter is drawn from some nodes of its axis.

    Parameters
    ----------
    name : str
    nodes : float, shape (nodes,)
        Of the axis, numbers.
    stencil : int, shape (drawn,)
        Those to draw from, at least 2.
    value : float

    Raises
    ------
    ValueError
        For an axis of one node, or where light goes as a root from this value on.
    """
    if len(stencil) < 2:
        raise invalid(f"derivatives ({name})", len(nodes), "an axis of two nodes or more")
    kind, at = transform_axis(name, nodes)
    x = float(apply_axis_transform(kind, np.array(value)))
    if kind == "root" and value <= _TINY:
        hint = "light goes as a root there: ask for it a little away"
        raise invalid(f"derivatives ({name})", value, "where the derivative is finite", hint)
    rate = {
        "logarithm": lambda: 1.0 / value, "root": lambda: 0.5 / x, "itself": lambda: 1.0,
        "cosine": lambda: float(np.radians(1.0) * np.sin(np.radians(value))),
    }[kind]()  # fmt: skip
    share = rate * _compute_lagrange_derivatives(at[stencil], x)
    fewer = share.copy()
    if len(stencil) > 2:
        far = int(np.argmax(np.abs(at[stencil] - x)))
        kept = np.delete(np.arange(len(stencil)), far)
        fewer = np.zeros_like(share)
        fewer[kept] = rate * _compute_lagrange_derivatives(at[stencil][kept], x)
    return DerivativeWeights(share, fewer)


def differentiate(
    part: xr.Dataset,
    quantity: str,
    weights: Sequence[InterpolationWeights],
    axis: int,
    derivative_weights: DerivativeWeights,
) -> DerivativeEstimate:
    """Return the derivative along one axis at a place.

    Parameters
    ----------
    part : xarray.Dataset
        The nodes around the place, all axes in the order of `weights`, the wavelength last.
    quantity : str
    weights : sequence of InterpolationWeights
        Of every axis.
    axis : int
        The axis to derive along.
    derivative_weights : Slope
        Of its nodes.
    """
    values = part[quantity].values.astype(float)
    shares = [w.weights for w in weights]
    along = [*shares[:axis], derivative_weights.weights, *shares[axis + 1 :]]
    plain = [*shares[:axis], derivative_weights.lower_order_weights, *shares[axis + 1 :]]
    value = _apply_weights(values, weights, along)
    missed = (value - _apply_weights(values, weights, plain)) ** 2
    for i, w in enumerate(weights):
        if i != axis and len(w.error_weights):
            missed = missed + max(
                (
                    _apply_full_axis_weights(values, weights, along, i, row) ** 2
                    for row in w.error_weights
                ),
                key=lambda off: float(off.sum()),
            )
    groups = f"{quantity}_batches"
    error = part[f"{quantity}_stderr"].values.astype(float)
    variance = _apply_weights(error**2, weights, [s**2 for s in along])
    if groups in part:
        order = [d for d in part[quantity].dims if d != "wavelength"]
        deviations = part[groups].transpose(*order, "batch", "wavelength").values.astype(float)
        variance = (_apply_weights(deviations, weights, along) ** 2).sum(axis=0)
    return DerivativeEstimate(value, np.sqrt(variance), np.sqrt(missed))


def make_derivative_dataset(
    estimates: dict[str, list[DerivativeEstimate]],
    names: Sequence[str],
    wavelength: Any,
    attrs: dict[str, Any],
) -> xr.Dataset:
    """Return derivatives by quantity as a dataset, over ``parameter`` and ``wavelength``."""
    dims = ("parameter", "wavelength")
    variables = {}
    for quantity, rows in estimates.items():
        label = f"derivative of {quantity} to the parameter, in the inverse of its unit"
        error = [np.hypot(one.stderr, one.interpolation_error) for one in rows]
        for end, values, about in (
            ("", [one.value for one in rows], label),
            ("_stderr", error, f"standard error of the {label}"),
        ):
            about_it = {"long_name": about, "units": "1"}
            variables[f"{quantity}_jacobian{end}"] = (dims, np.stack(values), about_it)
    units = [get_derivative_unit(name) for name in names]
    axes = {
        "parameter": ("parameter", list(names), {"long_name": "parameter"}),
        "parameter_unit": ("parameter", units, {"long_name": "unit of derivatives to it"}),
        "wavelength": wavelength,
    }
    return xr.Dataset(variables, axes, attrs)


def check_derivative_axes(names: Any, axes: Sequence[str]) -> list[str]:
    """Return the axes to derive along, or refuse them."""
    if isinstance(names, str) or not isinstance(names, Sequence) or not names:
        raise invalid("names", names, f"a list of {', '.join(axes)}")
    for name in names:
        if name not in axes:
            raise unknown_key(f"names.{name}", axes)
    if len(set(names)) < len(names):
        raise invalid("names", list(names), "each once")
    return list(names)


def _apply_weights(
    values: np.ndarray, weights: Sequence[InterpolationWeights], axis_weights: Sequence[np.ndarray]
) -> np.ndarray:
    """Return the sum over all axes, by shares of the nodes that each is drawn from."""
    for w, share in zip(weights, axis_weights, strict=True):
        values = np.tensordot(share, values[w.nodes], 1)
    return values


def _apply_full_axis_weights(
    values: np.ndarray, weights: Sequence[InterpolationWeights], axis_weights: Sequence[np.ndarray], axis: int,
    full_weights: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return that sum with other shares of all nodes along one axis."""
    for i, (w, share) in enumerate(zip(weights, axis_weights, strict=True)):
        values = np.tensordot(full_weights if i == axis else share,
                              values if i == axis else values[w.nodes], 1)  # fmt: skip
    return values


def _compute_lagrange_derivatives(nodes: np.ndarray, x: float) -> np.ndarray:
    """Return the weights of the slope of Lagrange's polynomial."""
    found = np.zeros(len(nodes))
    for i, one in enumerate(nodes):
        for left in range(len(nodes)):
            if left == i:
                continue
            term = 1.0 / (one - nodes[left])
            for j, other in enumerate(nodes):
                if j not in (i, left):
                    term *= (x - other) / (one - other)
            found[i] += term
    return found
