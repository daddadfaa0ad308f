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


class DerivativeEstimate(NamedTuple):
    """Spectral derivative with its standard error from the nodes and its interpolation error."""

    value: np.ndarray
    stderr: np.ndarray
    interpolation_error: np.ndarray


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
