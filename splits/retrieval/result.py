"""Result of a retrieval: dataset with its settings as attributes, summary and warnings."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Number
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import check_named_numbers
from splits.core.uncertainty import make_variable
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.media.parameters import describe_parameter
from splits.retrieval.measurement import Measurement
from splits.retrieval.optimal_estimation import (
    ALTERNATIVE_CHI2,
    MAX_PRIOR_TENSION,
    MIN_EFFECTIVE_DRAWS,
    MIN_SEPARATION,
    N_DRAWS,
    Solution,
    compute_fit_degrees_of_freedom,
)
from splits.retrieval.state_vector import SCALE, StateVector
from splits.simulation.run_options import make_wavelength_coordinate
from splits.tables.table import Table

FIXED_PREFIX = "fixed_"
"""Beginning of the attributes of fixed values."""
TABLE_SOLVER = "table"
"""Attribute ``solver`` of a retrieval with a table."""


def describe_model(model: Any, solver: str) -> dict[str, Any]:
    """Return the attributes of a model: its solver and its medium.

    Parameters
    ----------
    model : Table or Medium
        Values of free parameters in a medium have no effect.
    solver : str
    """
    if isinstance(model, Table):
        medium = model.dataset.attrs.get("medium")
        return {"solver": solver} | ({} if medium is None else {"medium": medium})
    details = {f"{model.kind}_{key}": value for key, value in model.describe().items()}
    return {"solver": solver, "medium": model.kind, **details}


def describe_parameters(
    state_vector: StateVector, fixed: Mapping[str, Any], prior: Mapping[str, Any] | None, seed: int
) -> dict[str, Any]:
    """Return the attributes of the free and fixed parameters and of the seed.

    ``free_NAME`` is the range (low, high), ``prior_NAME`` the prior (mean, standard deviation) as
    given, and ``fixed_NAME`` a fixed value.
    """
    limits = zip(state_vector.names, state_vector.low, state_vector.high, strict=True)
    names = ("mean", "standard deviation")
    return {
        **{f"{FIXED_PREFIX}{name}": value for name, value in fixed.items()},
        **{f"free_{name}": [float(low), float(high)] for name, low, high in limits},
        **{
            f"prior_{name}": list(check_named_numbers(f"prior.{name}", pair, names))
            for name, pair in (prior or {}).items()
        },
        "seed": seed,
    }


BOUND_DISTANCE = 0.01
"""Distance of a coordinate from a bound below which a value lies at it."""
MAX_NONLINEARITY = 1.0
"""Deviation of linear or interpolated reflectances, in units of noise, which is reported."""


def list_warnings(
    state_vector: StateVector, solution: Solution, constrained: np.ndarray
) -> list[str]:
    """Return the warnings about a result."""
    estimates, _, draws, variance_inflation, tension, *_ = solution
    best, warnings = estimates[0], []
    if variance_inflation > 1.0:
        warnings.append(
            f"the model does not fit the measurement within its noise: errors are multiplied by "
            f"{np.sqrt(variance_inflation):.3g}, and may still be too small"
        )
    unconstrained = [
        name
        for name, is_constrained in zip(state_vector.names, constrained, strict=True)
        if not is_constrained
    ]
    if unconstrained:
        warnings.append(f"not constrained by the measurement: {', '.join(unconstrained)}")
    for name, tension_sigma in zip(state_vector.names, tension, strict=True):
        if tension_sigma > MAX_PRIOR_TENSION:
            warnings.append(
                f"{name}: prior and measurement are {tension_sigma:.1f} standard deviations apart"
            )
    for i, name in enumerate(state_vector.names):
        low, high = (
            float(state_vector.to_physical(np.full(len(state_vector.names), x))[i])
            for x in (0.0, 1.0)
        )
        if not (constrained[i] or best.active_bounds[i]):
            continue
        if best.state[i] < BOUND_DISTANCE and low != 0.0:
            warnings.append(f"{name} lies at the low end of its range, {low:g}")
        if best.state[i] > 1.0 - BOUND_DISTANCE:
            warnings.append(f"{name} lies at the high end of its range, {high:g}")
    warnings += _list_alternatives(state_vector, solution)
    if solution.nonlinearity > MAX_NONLINEARITY:
        warnings.append(
            "errors are approximate: they use linear or interpolated reflectances, which deviate "
            f"from those of the model by up to {solution.nonlinearity:.1f} times the noise"
        )
    if draws.n_effective < MIN_EFFECTIVE_DRAWS:
        warnings.append(f"quantiles are imprecise: {draws.n_effective:.0f} effective draws")
    return warnings


def _list_alternatives(state_vector: StateVector, solution: Solution) -> list[str]:
    """Return the warnings about distinct alternative solutions."""
    best, *others = (estimate.state for estimate in solution.estimates)
    listed, warnings = [best], []
    for alternative in [*others[:1], *solution.alternatives]:
        difference = alternative - best
        is_within_error = (
            difference @ np.linalg.solve(solution.posterior.covariance, difference)
            < ALTERNATIVE_CHI2
        )
        distances = [np.abs(alternative - state).max() for state in listed]
        if is_within_error or min(distances) < MIN_SEPARATION:
            continue
        listed.append(alternative)
        is_near = np.abs(solution.draws.states - alternative).max(axis=1) < 0.5 * distances[0]
        coverage = "" if is_near.any() else ", but draws do not cover it"
        values = [
            f"{parameter} {value:.3g}"
            for parameter, value in zip(
                state_vector.names, state_vector.to_physical(alternative), strict=True
            )
        ]
        warnings.append(
            f"an alternative solution fits nearly as well{coverage}: {', '.join(values)}"
        )
    return warnings


QUANTILES = (0.025, 0.16, 0.5, 0.84, 0.975)
UNDETERMINED_FRACTION = 0.5
"""Ratio of posterior to prior standard deviation from which a parameter is unconstrained."""


NOISE_GIVEN = "as given"


class RetrievalResult:
    """Result of a retrieval.

    Parameters
    ----------
    dataset : xarray.Dataset
        See `splits.retrieve`.

    Attributes
    ----------
    dataset : xarray.Dataset
    """

    def __init__(self, dataset: xr.Dataset) -> None:
        self.dataset = dataset

    @property
    def values(self) -> dict[str, float]:
        """Medians by parameter."""
        return self._list_by_parameter(self.dataset.quantiles.sel(quantile=0.5))

    @property
    def stderr(self) -> dict[str, float]:
        """Standard deviations by parameter."""
        return self._list_by_parameter(self.dataset.value_stderr)

    @property
    def constrained(self) -> dict[str, bool]:
        """Whether the measurement constrains each parameter."""
        return self._list_by_parameter(self.dataset.constrained.astype(bool))

    def _list_by_parameter(self, values: xr.DataArray) -> dict[str, Any]:
        return dict(zip(map(str, values.parameter.values), values.values.tolist(), strict=True))

    @property
    def warnings(self) -> list[str]:
        """Warnings about the result."""
        text = str(self.dataset.attrs["warnings"])
        return [] if text == "none" else text.split("; ")

    def __repr__(self) -> str:
        """Return a line per parameter with its error, the misfit, fixed values and warnings."""
        quantiles = self.dataset.quantiles
        lines = []
        for name in map(str, quantiles.parameter.values):
            low, middle, high = quantiles.sel(parameter=name, quantile=[0.16, 0.5, 0.84]).values
            unit = str(self.dataset.parameter_unit.sel(parameter=name).item())
            unit = {"1e-9": "ng/g", "um": "µm", "degree": "°", "m2 kg-1": "m²/kg"}.get(unit, unit)
            suffix = f" {unit}" if unit != "1" else ""
            if not self.constrained[name]:
                suffix += ", not constrained by the measurement"
            lines.append(f"{name} {middle:.4g} ({low:.4g} to {high:.4g}){suffix}")
        attributes = self.dataset.attrs
        known_noise = f"chi2 {attributes['chi2']:.4g} of {attributes['chi2_expected']:.4g}"
        unknown_noise = (
            f"rms {attributes['rmse']:.4g}, from which errors are estimated, as noise is not given"
        )
        lines.append(
            f"misfit: {known_noise if attributes['noise'] == NOISE_GIVEN else unknown_noise}; "
            f"{attributes['degrees_of_freedom']:.2f} degrees of freedom of signal, "
            f"{attributes['information_bits']:.1f} bits"
        )
        fixed = [
            f"{key.removeprefix(FIXED_PREFIX)} {value:.4g}"
            if isinstance(value, Number)
            else f"{key.removeprefix(FIXED_PREFIX)} {value}"
            for key, value in attributes.items()
            if key.startswith(FIXED_PREFIX)
        ]
        lines += [f"fixed: {', '.join(fixed)}"] if fixed else []
        return "\n".join([*lines, *(f"! {line}" for line in self.warnings)])


def make_result(
    state_vector: StateVector,
    measurement: Measurement,
    solution: Solution,
    settings: Mapping[str, Any],
) -> RetrievalResult:
    """Return the result of a retrieval as a dataset.

    `settings` are attributes, see `splits.retrieval.result`.
    """
    (best, *_), summary, draws, variance_inflation, _, model_error, *_ = solution
    value, physical = state_vector.to_physical(best.state), state_vector.to_physical(draws.states)
    spread = draws.states.std(axis=0)
    prior_sd = np.sqrt(state_vector.prior_variance)
    constrained = spread < UNDETERMINED_FRACTION * prior_sd
    noise = np.sqrt(np.diag(measurement.covariance))
    parameter_dims, pair_dims = ("parameter",), ("parameter", "other_parameter")
    quantiles = np.quantile(physical, QUANTILES, axis=0)
    with np.errstate(invalid="ignore"):
        correlation = np.nan_to_num(np.atleast_2d(np.corrcoef(draws.states, rowvar=False)))
    variables = {
        **make_variable(
            "value", parameter_dims, value, physical.std(axis=0), "most probable value"
        ),
        **make_variable("mean", parameter_dims, physical.mean(axis=0), None, "mean"),
        **make_variable(
            "constrained",
            parameter_dims,
            constrained.astype(np.int8),
            None,
            "1 where the measurement halves the prior standard deviation",
        ),
        **make_variable("quantiles", ("quantile", "parameter"), quantiles, None, "quantiles"),
        **make_variable(
            "averaging_kernel",
            pair_dims,
            summary.averaging_kernel * prior_sd / prior_sd[:, np.newaxis],
            None,
            "averaging kernel, in units of the prior standard deviation",
        ),
        **make_variable("correlation", pair_dims, correlation, None, "correlation of coordinates"),
        **make_variable("draws", ("draw", "parameter"), physical, None, "draws from the posterior"),
        **make_variable("measured", "wavelength", measurement.values, noise, "measured"),
        **make_variable(
            "fitted", "wavelength", best.modelled, model_error, "of the most probable value"
        ),
    }
    attributes: dict[str, Any] = {
        "title": "Retrieval",
        **settings,
        "rmse": float(np.sqrt(np.mean((best.modelled - measurement.values) ** 2))),
        "noise": NOISE_GIVEN if measurement.noise_known else "found from the misfit",
        "chi2": variance_inflation * best.chi2,
        "chi2_expected": len(best.modelled) - compute_fit_degrees_of_freedom(best, state_vector),
        "error_inflation": float(np.sqrt(variance_inflation)),
        "degrees_of_freedom": summary.degrees_of_freedom,
        "information_bits": summary.information_bits,
        "effective_sample_size": draws.n_effective,
        "warnings": "; ".join(list_warnings(state_vector, solution, constrained)) or "none",
        **make_provenance("retrieval"),
    }
    names = list(state_vector.names)
    labels = [f"{name}: {describe_parameter(name)[0]}" for name in names]
    units = [describe_parameter(name)[1] if name != SCALE else "1" for name in names]
    coordinates = {
        "parameter": ("parameter", names, {"long_name": "parameter"}),
        "other_parameter": ("other_parameter", names, {"long_name": "parameter"}),
        "parameter_unit": ("parameter", units, {"long_name": "unit of the parameter"}),
        "parameter_label": ("parameter", labels, {"long_name": "parameter in words"}),
        "quantile": ("quantile", np.array(QUANTILES), {"long_name": "probability", "units": "1"}),
        "draw": ("draw", np.arange(N_DRAWS), {"long_name": "draw"}),
        "wavelength": make_wavelength_coordinate(measurement.wavelength_nm),
    }
    return RetrievalResult(xr.Dataset(variables, coordinates, to_netcdf_attributes(attributes)))
