"""Which parameter a spectrum tells of at which wavelength: Sobol indices over a table.

The first-order index is the share of the variance of reflectance that a parameter makes by itself,
the total one the share that would be left if all others were known.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.optional import import_optional
from splits.core.uncertainty import make_variable as with_error
from splits.core.validation import check_choice, invalid, reject_unknown_arguments
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.retrieval.forward_model import TableForwardModel, get_table_ranges
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import SCALE, StateVector
from splits.simulation.arguments import check_integer
from splits.simulation.attributes import make_wavelength_coordinate
from splits.tables.table import Table

N_REPEATS = 16
"""Independent estimates, from whose scatter the errors are."""
MIN_STANDARD_DEVIATION = 1e-6
"""Standard deviation of a reflectance below which nothing makes it vary."""


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

    Parameters are taken as independent and even in the coordinate in which light changes evenly:
    the logarithm of a size, the root of an amount from 0 on, over their ranges.

    Parameters
    ----------
    table : MethodTable
    free : sequence of str or mapping
        Axes of the table that vary, at least two, or their (low, high) by name.
    fixed : mapping
        Values of the other axes.
    quantity : str
        Of the table.
    points : int
        Of each of 16 independent estimates: a power of 2, 64 to 65 536.
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
    points, seed = check_integer("points", points, 64, 65_536), check_integer("seed", seed, 0)
    if points & (points - 1):
        raise invalid("points", points, "a power of 2")
    which = StateVector.from_ranges(free, None, get_table_ranges(table))
    if len(which.names) < 2 or SCALE in which.names:
        raise invalid("free", list(which.names), "two axes of the table or more")
    w = table.dataset.wavelength.values
    plain = Measurement.from_input((w, np.full(w.size, 0.5)), 0.01)
    model = TableForwardModel(table, plain, which, fixed, quantity)
    shares = _estimate_variance_fractions(model, points, seed)
    variables: dict[str, Any] = {}
    for name, label, rows in (
        ("first_order", "first-order Sobol index", shares.first_order),
        ("total", "total Sobol index", shares.total),
        ("first_order_sum", "sum of first-order Sobol indices", shares.first_order.sum(axis=1)),
    ):
        dims = ("parameter", "wavelength") if rows.ndim == 3 else ("wavelength",)
        error = rows.std(axis=0, ddof=1) / np.sqrt(N_REPEATS)
        variables |= with_error(name, dims, rows.mean(axis=0), error, label)
    long_name = f"standard deviation of {quantity}"
    variables |= with_error(
        "standard_deviation", "wavelength", shares.standard_deviation, None, long_name
    )
    axes = {
        "parameter": ("parameter", list(which.names), {"long_name": "parameter"}),
        "low": ("parameter", which.low, {"long_name": "low end of its range"}),
        "high": ("parameter", which.high, {"long_name": "high end of its range"}),
        "wavelength": make_wavelength_coordinate(w),
    }
    facts = {"title": "Sobol indices", "points": points, "repeats": N_REPEATS, "seed": seed}
    return xr.Dataset(
        variables, axes, to_netcdf_attributes({**facts, **make_provenance("Sobol indices")})
    )


class _VarianceFractions(NamedTuple):
    """Independent estimates of shares of the variance, and its root.

    Attributes
    ----------
    first_order, total : float, shape (REPEATS, parameters, wavelengths)
    standard_deviation : float, shape (wavelengths,)
    """

    first_order: np.ndarray
    total: np.ndarray
    standard_deviation: np.ndarray


def _estimate_variance_fractions(
    model: TableForwardModel, points: int, seed: int
) -> _VarianceFractions:
    """Return the shares of the variance, 0 where nothing varies."""
    stats = import_optional("scipy.stats", "retrieval", "Sobol indices need")
    many, count = len(model.state_vector.names), model.node_values.shape[1]
    varying = model.node_values.std(axis=0) > MIN_STANDARD_DEVIATION
    first, total = np.zeros((2, N_REPEATS, many, count))
    spread = np.zeros(count)
    if not varying.any():
        return _VarianceFractions(first, total, spread)

    def look(places: np.ndarray) -> np.ndarray:
        found: np.ndarray = model.evaluate(np.ascontiguousarray(places.T))[:, varying].T
        return found

    for number in range(N_REPEATS):
        random = np.random.default_rng([seed, number])
        found = stats.sobol_indices(func=look, n=points, dists=[stats.uniform()] * many, rng=random)
        first[number][:, varying] = np.reshape(found.first_order, (-1, many)).T
        total[number][:, varying] = np.reshape(found.total_order, (-1, many)).T
    places = np.random.default_rng(seed).random((many, 4 * points))
    spread[varying] = look(places).std(axis=1)
    return _VarianceFractions(first, total, spread)
