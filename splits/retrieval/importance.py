"""Which parameter a spectrum tells of at which wavelength: Sobol indices over a table.

The first-order index is the share of the variance of reflectance that a parameter makes by itself,
the total one the share that would be left if all others were known.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.checks import known_arguments, one_of, refuse
from splits.dataset import attributes, provenance
from splits.extras import optional
from splits.instruments.arguments import check_whole
from splits.instruments.labels import wavelength_axis
from splits.lookup.reading import Table
from splits.retrieval.coordinates import LEVEL, Free
from splits.retrieval.forward import OfTable, ranges_of
from splits.retrieval.measurement import Measurement
from splits.uncertainty import quantity as with_error

REPEATS = 16
"""Independent estimates, from whose scatter the errors are."""
LEAST_SD = 1e-6
"""Standard deviation of a reflectance below which nothing makes it vary."""


@known_arguments
def sobol_indices(
    table: Table,
    free: Any,
    *,
    at: Mapping[str, Any] | None = None,
    quantity: str = "reflectance",
    points: int = 1024,
    seed: int = 1,
) -> xr.Dataset:
    """Return first-order and total Sobol indices of parameters at all wavelengths of a table.

    Parameters are taken as independent and even in the coordinate in which light changes evenly:
    the logarithm of a size, the root of an amount from 0 on, over their ranges.

    Parameters
    ----------
    table : Table
    free : sequence of str or mapping
        Axes of the table that vary, at least two, or their (low, high) by name.
    at : mapping
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
        raise refuse("table", type(table).__name__, "a Table", "splits.open_table(…)")
    one_of("quantity", quantity, table.quantities)
    points, seed = check_whole("points", points, 64, 65_536), check_whole("seed", seed, 0)
    if points & (points - 1):
        raise refuse("points", points, "a power of 2")
    which = Free.from_ranges(free, None, ranges_of(table))
    if len(which.names) < 2 or LEVEL in which.names:
        raise refuse("free", list(which.names), "two axes of the table or more")
    w = table.dataset.wavelength.values
    plain = Measurement.from_input((w, np.full(w.size, 0.5)), 0.01)
    model = OfTable(table, plain, which, at, quantity)
    shares = _shares(model, points, seed)
    variables: dict[str, Any] = {}
    for name, label, rows in (
        ("first_order", "first-order Sobol index", shares.first_order),
        ("total", "total Sobol index", shares.total),
        ("first_order_sum", "sum of first-order Sobol indices", shares.first_order.sum(axis=1)),
    ):
        dims = ("parameter", "wavelength") if rows.ndim == 3 else ("wavelength",)
        error = rows.std(axis=0, ddof=1) / np.sqrt(REPEATS)
        variables |= with_error(name, dims, rows.mean(axis=0), error, label)
    long_name = f"standard deviation of {quantity}"
    variables |= with_error("standard_deviation", "wavelength", shares.standard_deviation, None, long_name)
    axes = {
        "parameter": ("parameter", list(which.names), {"long_name": "parameter"}),
        "low": ("parameter", which.low, {"long_name": "low end of its range"}),
        "high": ("parameter", which.high, {"long_name": "high end of its range"}),
        "wavelength": wavelength_axis(w),
    }
    facts = {"title": "Sobol indices", "points": points, "repeats": REPEATS, "seed": seed}
    return xr.Dataset(variables, axes, attributes({**facts, **provenance("Sobol indices")}))


class _Shares(NamedTuple):
    """Independent estimates of shares of the variance, and its root.

    Attributes
    ----------
    first, total : float, shape (REPEATS, parameters, wavelengths)
    spread : float, shape (wavelengths,)
    """

    first_order: np.ndarray
    total: np.ndarray
    standard_deviation: np.ndarray


def _shares(model: OfTable, points: int, seed: int) -> _Shares:
    """Return the shares of the variance, 0 where nothing varies."""
    stats = optional("scipy.stats", "retrieval", "Sobol indices need")
    many, count = len(model.state_vector.names), model.node_values.shape[1]
    varying = model.node_values.std(axis=0) > LEAST_SD
    first, total = np.zeros((2, REPEATS, many, count))
    spread = np.zeros(count)
    if not varying.any():
        return _Shares(first, total, spread)

    def look(places: np.ndarray) -> np.ndarray:
        found: np.ndarray = model.evaluate(np.ascontiguousarray(places.T))[:, varying].T
        return found

    for number in range(REPEATS):
        random = np.random.default_rng([seed, number])
        found = stats.sobol_indices(func=look, n=points, dists=[stats.uniform()] * many, rng=random)
        first[number][:, varying] = np.reshape(found.first_order, (-1, many)).T
        total[number][:, varying] = np.reshape(found.total_order, (-1, many)).T
    places = np.random.default_rng(seed).random((many, 4 * points))
    spread[varying] = look(places).std(axis=1)
    return _Shares(first, total, spread)
