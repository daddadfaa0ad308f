"""Greedy selection of the most informative bands of a sensor.

The information content of a set of bands is the mean over the parameter ranges of the information
that they add to the prior (Rodgers 1996, Proceedings of SPIE 2830, 136-148).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import as_1d_array
from splits.core.keywords import reject_unknown_arguments
from splits.core.parameter_names import describe_parameter
from splits.core.validation import check_integer, invalid
from splits.illumination.bands import as_bands
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.retrieval.forward_model import TableForwardModel, get_table_ranges
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import StateVector
from splits.tables.table import Table

N_STATES = 200
"""Number of states in the ranges over which information is averaged."""


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
    """Return the most informative bands, each adding the most information to those before it.

    Parameters
    ----------
    table : Table
    bands : mapping, str or array_like
        As for `splits.albedo`, or a row of wavelengths (nm).
    free : sequence of str or mapping
        As for `splits.retrieve`.
    noise : float or array_like
        Standard errors, one or as many as bands.
    n_bands : int
        Number of bands, from 1 to all.
    fixed, prior : mapping
        As for `splits.retrieve`.
    seed : int
        Seed of the states over which the mean is taken.

    Returns
    -------
    xarray.Dataset
        Over ``step``: the selected ``band``, ``information_bits`` of all bands up to it with the
        standard error of the mean, and ``spread`` over ``parameter``: the posterior standard
        deviation of its coordinate relative to the prior one.

    Raises
    ------
    ValueError
        For the same arguments as `splits.retrieve`.
    """
    if not isinstance(table, Table):
        raise invalid("table", type(table).__name__, "a Table", "splits.open_table(…)")
    measurement, names = _make_hypothetical_measurement(bands, noise)
    covariance = measurement.check_noise_known().covariance
    if (covariance != np.diag(np.diag(covariance))).any():
        hint = "bands are selected one by one"
        raise invalid("noise", "correlated errors", "independent standard errors", hint)
    n_bands = check_integer("n_bands", n_bands, 1, len(names))
    state_vector = StateVector.from_ranges(free, prior, get_table_ranges(table))
    model = TableForwardModel(table, measurement, state_vector, fixed)
    random = np.random.default_rng(check_integer("seed", seed, 0))
    jacobians, stderr = [], []
    for state in random.random((N_STATES, len(state_vector.names))):
        covariance = measurement.covariance + model.compute_error_covariance(state)
        # The selection assumes independent errors of the bands.
        stderr.append(np.sqrt(np.diag(covariance)))
        jacobians.append(model.evaluate_with_jacobian(state)[1])
    whitened_jacobians = np.array(jacobians) / np.array(stderr)[:, :, np.newaxis]
    selected, information, relative_spread = _select_greedily(
        whitened_jacobians, state_vector.prior_variance, n_bands
    )
    labels = [describe_parameter(name)[0] for name in state_vector.names]
    variables = {
        "band": ("step", np.array(names)[selected], {"long_name": "band"}),
        "information_bits": (
            "step", information.mean(axis=1), {"long_name": "information, mean", "units": "1"},
        ),
        "information_bits_stderr": (
            "step", information.std(axis=1, ddof=1) / np.sqrt(N_STATES),
            {"long_name": "standard error of the mean over the ranges", "units": "1"},
        ),
        "spread": (
            ("step", "parameter"), relative_spread,
            {"long_name": "posterior over prior standard deviation", "units": "1"},
        ),
    }  # fmt: skip
    axes = {
        "step": ("step", np.arange(1, n_bands + 1), {"long_name": "number of bands", "units": "1"}),
        "parameter": ("parameter", list(state_vector.names), {"long_name": "parameter"}),
        "parameter_label": ("parameter", labels, {"long_name": "parameter in words"}),
    }
    attributes = {
        "title": "Most informative bands",
        "seed": seed,
        **make_provenance("band selection"),
    }
    return xr.Dataset(variables, axes, to_netcdf_attributes(attributes))


def _make_hypothetical_measurement(bands: Any, noise: Any) -> tuple[Measurement, list[str]]:
    """Return a measurement of the bands with arbitrary values, and the names of the bands."""
    if not isinstance(bands, str | Mapping):
        w = as_1d_array("bands", bands, "a mapping of bands, a sensor or wavelengths (nm)")
        measurement = Measurement.from_input((w, np.full(w.shape, 0.5)), noise)
        return measurement, [f"{wavelength:g} nm" for wavelength in measurement.wavelength_nm]
    spectral_bands = as_bands(bands)
    return Measurement.from_input(np.full(len(spectral_bands), 0.5), noise, bands), list(
        spectral_bands
    )


def _select_greedily(
    jacobians: np.ndarray, prior_variance: np.ndarray, n_bands: int
) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Return the bands, information by step and state, and relative spread by step and parameter.

    Parameters
    ----------
    jacobians : float, shape (states, bands, parameters)
        Jacobians in units of noise.
    prior_variance : float, shape (parameters,)
        Variance of the prior.
    """
    posterior = np.tile(np.diag(prior_variance), (len(jacobians), 1, 1))
    total_information = np.zeros(len(jacobians))
    chosen: list[int] = []
    information, relative_spread = [], []
    for _ in range(n_bands):
        # Gain of another band: ln(1 + kᵀ S k)/2 (matrix determinant lemma), then the update of S.
        gain = np.log2(1.0 + np.einsum("pbi,pij,pbj->pb", jacobians, posterior, jacobians)) / 2.0
        mean = gain.mean(axis=0)
        mean[chosen] = -np.inf
        best = int(mean.argmax())
        chosen.append(best)
        row = np.einsum("pij,pj->pi", posterior, jacobians[:, best])
        scale = 1.0 + np.einsum("pi,pi->p", jacobians[:, best], row)
        posterior = posterior - row[:, :, np.newaxis] * row[:, np.newaxis] / scale[:, None, None]
        total_information = total_information + gain[:, best]
        information.append(total_information)
        relative_spread.append(
            np.sqrt(np.diagonal(posterior, axis1=1, axis2=2) / prior_variance).mean(axis=0)
        )
    return chosen, np.array(information), np.array(relative_spread)
