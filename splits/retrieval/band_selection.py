"""Which bands of a sensor tell most: greedily, one after the other.

How much a few bands tell of what is free is the information that they would add to what was known
before, in the mean over the ranges (Rodgers 1996, Proceedings of SPIE 2830, 136-148).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import as_1d_array
from splits.core.parameter_names import describe_parameter
from splits.core.validation import invalid, reject_unknown_arguments
from splits.illumination.bands import as_bands
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.retrieval.forward_model import TableForwardModel, get_table_ranges
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import StateVector
from splits.simulation.arguments import check_integer
from splits.tables.table import Table

N_STATES = 200
"""Places in the ranges over which information is averaged."""


@reject_unknown_arguments
def select_bands(
    table: Table,
    bands: Any,
    free: Any,
    noise: Any,
    n_bands: int = 5,
    *,
    fixed: Mapping[str, Any] | None = None,
    prior: Mapping[str, Any] | None = None,
    seed: int = 1,
) -> xr.Dataset:
    """Return the bands that tell most, in the order in which each adds most to those before it.

    Parameters
    ----------
    table : MethodTable
    bands : mapping, str or array_like
        As for `splits.albedo`, or a row of wavelengths (nm).
    free : sequence of str or mapping
        As for `splits.retrieve`.
    noise : float or array_like
        Standard errors, one or as many as bands.
    n_bands : int
        How many bands, at least 1 and at most all.
    at, prior : mapping
        As for `splits.retrieve`.
    seed : int
        Of the places in the ranges over which the mean is taken.

    Returns
    -------
    xarray.Dataset
        Over ``step``: ``band`` chosen, ``information_bits`` of it and those before it and its
        standard error over the ranges, and ``spread`` over ``parameter``: the standard deviation
        that is left of its coordinate, as a part of that before.

    Raises
    ------
    ValueError
        As `splits.retrieve`.
    """
    if not isinstance(table, Table):
        raise invalid("table", type(table).__name__, "a Table", "splits.open_table(…)")
    measurement, names = _make_hypothetical_measurement(bands, noise)
    covariance = measurement.check_noise_known().covariance
    if (covariance != np.diag(np.diag(covariance))).any():
        hint = "bands are chosen one by one"
        raise invalid("noise", "errors that are alike", "standard errors, independent", hint)
    n_bands = check_integer("n_bands", n_bands, 1, len(names))
    which = StateVector.from_ranges(free, prior, get_table_ranges(table))
    model = TableForwardModel(table, measurement, which, fixed)
    random = np.random.default_rng(check_integer("seed", seed, 0))
    slopes, spread = [], []
    for place in random.random((N_STATES, len(which.names))):
        covariance = measurement.covariance + model.compute_error_covariance(place)
        # Bands are chosen one by one, as if their errors were independent.
        spread.append(np.sqrt(np.diag(covariance)))
        slopes.append(model.evaluate_with_jacobian(place)[1])
    k = np.array(slopes) / np.array(spread)[:, :, np.newaxis]
    chosen, bits, left = _select_greedily(k, which.prior_variance, n_bands)
    units = [describe_parameter(name)[0] for name in which.names]
    variables = {
        "band": ("step", np.array(names)[chosen], {"long_name": "band"}),
        "information_bits": (
            "step", bits.mean(axis=1), {"long_name": "information, mean", "units": "1"},
        ),
        "information_bits_stderr": (
            "step", bits.std(axis=1, ddof=1) / np.sqrt(N_STATES),
            {"long_name": "standard error of the mean over the ranges", "units": "1"},
        ),
        "spread": (
            ("step", "parameter"), left,
            {"long_name": "standard deviation left, as a part of that before", "units": "1"},
        ),
    }  # fmt: skip
    axes = {
        "step": ("step", np.arange(1, n_bands + 1), {"long_name": "number of bands", "units": "1"}),
        "parameter": ("parameter", list(which.names), {"long_name": "parameter"}),
        "parameter_label": ("parameter", units, {"long_name": "parameter in words"}),
    }
    facts = {"title": "Bands that tell most", "seed": seed, **make_provenance("band selection")}
    return xr.Dataset(variables, axes, to_netcdf_attributes(facts))


def _make_hypothetical_measurement(bands: Any, noise: Any) -> tuple[Measurement, list[str]]:
    """Return what would be measured, and what its bands are called."""
    if not isinstance(bands, str | Mapping):
        w = as_1d_array("bands", bands, "a mapping of bands, a sensor or wavelengths (nm)")
        found = Measurement.from_input((w, np.full(w.shape, 0.5)), noise)
        return found, [f"{one:g} nm" for one in found.wavelength_nm]
    some = as_bands(bands)
    return Measurement.from_input(np.full(len(some), 0.5), noise, bands), list(some)


def _select_greedily(
    jacobians: np.ndarray, prior_variance: np.ndarray, n_bands: int
) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Return the bands, information by step and place, and the spread left by step and parameter.

    Parameters
    ----------
    jacobians : float, shape (places, bands, parameters)
        Slopes in units of noise.
    prior_variance : float, shape (parameters,)
        Known before.
    """
    after = np.tile(np.diag(prior_variance), (len(jacobians), 1, 1))
    total = np.zeros(len(jacobians))
    chosen: list[int] = []
    bits, left = [], []
    for _ in range(n_bands):
        # One more measurement: ln(1 + kᵀ S k)/2 (matrix determinant lemma), then S by its update.
        gain = np.log2(1.0 + np.einsum("pbi,pij,pbj->pb", jacobians, after, jacobians)) / 2.0
        mean = gain.mean(axis=0)
        mean[chosen] = -np.inf
        best = int(mean.argmax())
        chosen.append(best)
        row = np.einsum("pij,pj->pi", after, jacobians[:, best])
        scale = 1.0 + np.einsum("pi,pi->p", jacobians[:, best], row)
        after = after - row[:, :, np.newaxis] * row[:, np.newaxis] / scale[:, None, None]
        total = total + gain[:, best]
        bits.append(total)
        left.append(np.sqrt(np.diagonal(after, axis1=1, axis2=2) / prior_variance).mean(axis=0))
    return chosen, np.array(bits), np.array(left)
