"""Sobol sensitivity indices of parameters at all wavelengths of a table.

The first-order index is the fraction of the variance of reflectance due to one parameter alone; the
total index is the fraction that remains if all other parameters are known.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.keywords import reject_unknown_arguments
from splits.core.optional import import_optional
from splits.core.uncertainty import make_variable as with_error
from splits.core.validation import check_choice, check_integer, invalid
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.retrieval.forward_model import TableForwardModel, get_table_ranges
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import SCALE, StateVector
from splits.simulation.run_options import make_wavelength_coordinate
from splits.tables.table import Table

N_REPEATS = 16
"""Number of independent estimates, whose scatter gives the errors."""
MIN_STANDARD_DEVIATION = 1e-6
"""Standard deviation of reflectance below which it counts as constant."""


@reject_unknown_arguments
def sobol_indices(
    table: Table,
    free: Any,
    *,
    fixed: Mapping[str, Any] | None = None,
    quantity: str = "reflectance",
    points: int = 1024,
    seed: int = 1,
) -> xr.Dataset:
    """Return first-order and total Sobol indices of parameters at all wavelengths of a table.

    Parameters are independent and uniform over their ranges, in the coordinate in which reflectance
    is closest to linear: the logarithm of a size, the square root of an amount from 0 on.

    Parameters
    ----------
    table : Table
    free : sequence of str or mapping
        Axes of the table that vary, at least two, or their (low, high) by name.
    fixed : mapping
        Values of the other axes.
    quantity : str
        Quantity of the table.
    points : int
        Points of each of the 16 independent estimates: a power of 2, 64 to 65 536.
    seed : int

    Returns
    -------
    xarray.Dataset
        ``first_order`` and ``total`` over ``parameter`` and ``wavelength``, and
        ``first_order_sum`` over wavelength, with standard errors of sampling; 0 where reflectance
        does not vary; its ``standard_deviation``.

    Raises
    ------
    ValueError
        For a value outside its range, or fewer than two parameters.

    References
    ----------
    Saltelli et al. (2010), Computer Physics Communications 181, 259-270; Sobol' (2001),
    Mathematics and Computers in Simulation 55, 271-280.
    """
    if not isinstance(table, Table):
        raise invalid("table", type(table).__name__, "a Table", "splits.open_table(…)")
    check_choice("quantity", quantity, table.quantities)
    if table.has_views:
        table, fixed = table.fix_view(fixed or {}, "fixed.")
    points, seed = check_integer("points", points, 64, 65_536), check_integer("seed", seed, 0)
    if points & (points - 1):
        raise invalid("points", points, "a power of 2")
    state_vector = StateVector.from_ranges(free, None, get_table_ranges(table))
    if len(state_vector.names) < 2 or SCALE in state_vector.names:
        raise invalid("free", list(state_vector.names), "two axes of the table or more")
    wavelength = table.dataset.wavelength.values
    measurement = Measurement.from_input((wavelength, np.full(wavelength.size, 0.5)), 0.01)
    model = TableForwardModel(table, measurement, state_vector, fixed, quantity)
    fractions = _estimate_variance_fractions(model, points, seed)
    variables: dict[str, Any] = {}
    for name, label, rows in (
        ("first_order", "first-order Sobol index", fractions.first_order),
        ("total", "total Sobol index", fractions.total),
        ("first_order_sum", "sum of first-order Sobol indices", fractions.first_order.sum(axis=1)),
    ):
        dims = ("parameter", "wavelength") if rows.ndim == 3 else ("wavelength",)
        error = rows.std(axis=0, ddof=1) / np.sqrt(N_REPEATS)
        variables |= with_error(name, dims, rows.mean(axis=0), error, label)
    long_name = f"standard deviation of {quantity}"
    variables |= with_error(
        "standard_deviation", "wavelength", fractions.standard_deviation, None, long_name
    )
    axes = {
        "parameter": ("parameter", list(state_vector.names), {"long_name": "parameter"}),
        "low": ("parameter", state_vector.low, {"long_name": "low end of its range"}),
        "high": ("parameter", state_vector.high, {"long_name": "high end of its range"}),
        "wavelength": make_wavelength_coordinate(wavelength),
    }
    attributes = {"title": "Sobol indices", "points": points, "repeats": N_REPEATS, "seed": seed}
    return xr.Dataset(
        variables, axes, to_netcdf_attributes({**attributes, **make_provenance("Sobol indices")})
    )


class _VarianceFractions(NamedTuple):
    """Independent estimates of the fractions of variance, and the standard deviation.

    Attributes
    ----------
    first_order, total : float, shape (N_REPEATS, parameters, wavelengths)
    standard_deviation : float, shape (wavelengths,)
    """

    first_order: np.ndarray
    total: np.ndarray
    standard_deviation: np.ndarray


def _estimate_variance_fractions(
    model: TableForwardModel, points: int, seed: int
) -> _VarianceFractions:
    """Return the fractions of variance, 0 where reflectance is constant."""
    stats = import_optional("scipy.stats", "retrieval", "Sobol indices need")
    n_parameters, n_wavelengths = len(model.state_vector.names), model.node_values.shape[1]
    is_varying = model.node_values.std(axis=0) > MIN_STANDARD_DEVIATION
    first_order, total = np.zeros((2, N_REPEATS, n_parameters, n_wavelengths))
    standard_deviation = np.zeros(n_wavelengths)
    if not is_varying.any():
        return _VarianceFractions(first_order, total, standard_deviation)

    def evaluate(states: np.ndarray) -> np.ndarray:
        modelled: np.ndarray = model.evaluate(np.ascontiguousarray(states.T))[:, is_varying].T
        return modelled

    for number in range(N_REPEATS):
        random = np.random.default_rng([seed, number])
        modelled = stats.sobol_indices(
            func=evaluate, n=points, dists=[stats.uniform()] * n_parameters, rng=random
        )
        first_order[number][:, is_varying] = np.reshape(modelled.first_order, (-1, n_parameters)).T
        total[number][:, is_varying] = np.reshape(modelled.total_order, (-1, n_parameters)).T
    states = np.random.default_rng(seed).random((n_parameters, 4 * points))
    standard_deviation[is_varying] = evaluate(states).std(axis=1)
    return _VarianceFractions(first_order, total, standard_deviation)
