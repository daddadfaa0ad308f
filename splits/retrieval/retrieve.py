"""Retrieval of medium parameters from a measured spectrum, with posterior uncertainty.

The result is a dataset with its settings as attributes, a summary and warnings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Number
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import check_named_numbers
from splits.core.inputs import Kernel, MaxRays, Seed, Solver, StandardError, Threads
from splits.core.keywords import declare_function
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import make_variable
from splits.core.validation import check_choice, invalid
from splits.illumination.bands import Bands
from splits.instruments.solver import AUTO
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.media.formatting import suggest_medium
from splits.media.kinds import list_media_names
from splits.media.parameters import INCIDENCE_KEY, describe_parameter
from splits.retrieval.forward_model import (
    TableForwardModel,
    choose_quantity,
    get_table_ranges,
)
from splits.retrieval.least_squares import retrieve_without_noise
from splits.retrieval.linearization import MAX_DEVIATION, estimate_nonlinearity, refine_posterior
from splits.retrieval.measurement import Measurement, check_modelled_quantity
from splits.retrieval.medium_model import (
    MediumForwardModel,
    OrdinatesForwardModel,
    check_measurement_incidence,
    make_medium_model,
    make_medium_state_vector,
)
from splits.retrieval.optimal_estimation import (
    ALTERNATIVE_CHI2,
    MAX_PRIOR_TENSION,
    MIN_EFFECTIVE_DRAWS,
    MIN_SEPARATION,
    N_DRAWS,
    Solution,
    compute_fit_degrees_of_freedom,
    solve_for_known_noise,
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
    unconstrained = np.array(state_vector.names)[~constrained].tolist()
    if unconstrained:
        warnings.append(f"not constrained by the measurement: {', '.join(unconstrained)}")
    for name, tension_sigma in zip(state_vector.names, tension, strict=True):
        if tension_sigma > MAX_PRIOR_TENSION:
            warnings.append(
                f"{name}: prior and measurement are {tension_sigma:.1f} standard deviations apart"
            )
    for i, name in enumerate(state_vector.names):
        low, high = state_vector.low[i], state_vector.high[i]
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


@dataclass(eq=False, repr=False)
class RetrievalResult:
    """Result of a retrieval.

    Attributes
    ----------
    dataset : xarray.Dataset
        See `splits.retrieve`.
    """

    dataset: xr.Dataset

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


def add_warning(dataset: xr.Dataset, warning: str) -> None:
    """Add a warning to those of a result."""
    others = dataset.attrs["warnings"]
    dataset.attrs["warnings"] = warning if others == "none" else f"{others}; {warning}"


def make_result(
    state_vector: StateVector,
    measurement: Measurement,
    solution: Solution,
    settings: Mapping[str, Any],
) -> RetrievalResult:
    """Return the result of a retrieval as a dataset.

    `settings` are attributes, see `describe_model` and `describe_parameters`.
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


@declare_function
def retrieve(
    measured: Any,
    model: Any,
    free: Any,
    noise: Any = None,
    *,
    max_stderr: StandardError | None = None,
    solver: Solver = "auto",
    fixed: Mapping[str, Any] | None = None,
    prior: Mapping[str, Any] | None = None,
    bands: Bands = None,
    quantity: str | None = None,
    seed: Seed = 1,
    max_rays: MaxRays = 20_000_000,
    threads: Threads = None,
    kernel: Kernel = "auto",
    progress: ProgressCallback = None,
) -> RetrievalResult:
    """Retrieve parameters from a measured spectrum, with their errors.

    The result has the most probable values and draws from the posterior distribution (optimal
    estimation; Rodgers 2000).  Its errors include the noise of the measurement, the errors of the
    table and those of interpolation in it.

    Parameters
    ----------
    measured : xarray.DataArray, pandas.Series or pair of array_like
        Reflectances over ``wavelength`` (nm), or (wavelengths, reflectances); one value per band
        with `bands`.  Labels may be in any order.  Other coordinates, such as ``incidence_deg``,
        and the name of the quantity must agree with the model.
    model : Table or medium
        A table, see `splits.build_table`; or a snow, sand, layer or stack,
        which is solved by discrete ordinates (a fraction of a second) or simulated as often as
        necessary (some minutes).
    free : sequence of str or mapping
        Free axes of the table, or their (low, high) by name.  For a medium, (low, high) of
        parameters named as for derivatives (``layers.0.depth_m``).  ``scale`` is a factor of the
        modelled reflectance, for a reference panel of unknown reflectance.
    noise : float, array_like or mapping, optional
        Noise of the measurement: one standard error or one per value, their covariance matrix, or
        ``{"stderr": …, "correlation_nm": …, "independent": …}``, errors with a correlation length
        and optional independent ones.  Without it, the fit is one of least squares, and the
        covariance of errors is estimated from the misfit, including its correlation between
        neighbouring values.
    max_stderr : float, optional
        Standard error of the final simulations of a medium; by default half of the smallest noise,
        within 0.001 to 0.01, and 0.002 for unknown noise.  For discrete ordinates, it determines
        the number of streams, and is 0.001 by default.
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
        Solver for a medium, as for `splits.spectrophotometer`.  "auto" uses discrete ordinates for
        natural snow if they apply within all ranges.
    fixed : mapping
        Values of the other axes, such as ``incidence_deg``, the only one for a medium, by default
        0, which the result then states.  For a table with directions, ``polar_deg`` and
        ``azimuth_deg`` are those of the measurement.  A field of view or isotropic light is given
        by `splits.Table.at_view`.
    prior : mapping
        (mean, standard deviation) of prior knowledge, by name.  The prior is normal in the
        coordinate of the parameter, in which reflectance is closest to linear: the logarithm of a
        size, the square root of an amount, the cosine of an angle.  Without it, the prior is
        uniform in this coordinate over the range.
    bands : mapping or str
        Bands of the sensor, as for `splits.albedo`.
    quantity : str, optional
        Quantity of the table, by default "reflectance"; required for a table with directions or
        for one direction, such as "reflectance_factor".
    seed : int
        Seed of the draws and of simulations.
    max_rays, threads, kernel
        For each simulation of a medium, as for `splits.spectrophotometer`.
    progress : callable or bool, optional
        See `splits.Progress`; True for a bar.  Only retrievals by simulation report.

    Returns
    -------
    RetrievalResult
        Its text is a summary.  Its ``dataset`` has, over ``parameter``: ``value`` (most probable)
        and ``value_stderr``, ``mean``, ``constrained``, ``quantiles`` over ``quantile``; the
        ``averaging_kernel`` and the ``correlation``; ``draws``; ``measured`` and ``fitted`` over
        ``wavelength``, with errors.  Attributes: ``rmse``, ``chi2`` and what to expect of it,
        ``degrees_of_freedom`` of signal, ``information_bits``, ``warnings``; and the settings:
        ``solver``, ``medium``, ``seed``, and ``free_…``, ``fixed_…`` and ``prior_…`` by parameter.

    Raises
    ------
    ValueError
        For gaps, values in per cent, noise of 0, wavelengths outside the table, invalid ranges, or
        discrete ordinates for a medium to which they do not apply.

    References
    ----------
    Rodgers (2000), Inverse Methods for Atmospheric Sounding, World Scientific.

    Examples
    --------
    >>> import splits
    >>> snow = splits.build_table(
    ...     splits.Snow.natural,
    ...     {"optical_radius_um": [50, 100, 200, 400, 800], "incidence_deg": [50]},
    ...     [860, 1030, 1240],
    ...     max_stderr=0.01,
    ... )
    >>> found = splits.retrieve(
    ...     ([860, 1030, 1240], [0.86, 0.68, 0.51]), snow, ["optical_radius_um"], 0.02
    ... )
    >>> found.constrained
    {'optical_radius_um': True}
    """
    forward_model: TableForwardModel | MediumForwardModel
    note = ""
    if isinstance(model, Table):
        if max_stderr is not None:
            raise invalid("max_stderr", max_stderr, "left out", "a table has its own errors")
        if solver != AUTO:
            raise invalid("solver", solver, "left out", "a table has its own spectra")
        quantity = choose_quantity(model, quantity)
        settings = describe_model(model, TABLE_SOLVER) | {"quantity": quantity}
        if model.has_views:
            model, fixed = model.fix_view(fixed or {}, "fixed.")
        check_choice("quantity", quantity, model.quantities)
        measurement = Measurement.from_input(measured, noise, bands)
        state_vector = StateVector.from_ranges(free, prior, get_table_ranges(model))
        forward_model = TableForwardModel(model, measurement, state_vector, fixed, quantity)
        fixed_values = forward_model.list_fixed_values()
        check_modelled_quantity("measured", measured, quantity, fixed_values)
    else:
        if isinstance(model, str | Mapping) or not hasattr(model, "kind"):
            shown = model if isinstance(model, str) or callable(model) else type(model).__name__
            hint = "splits.build_table(…), splits.Table(path), or a snow, sand, layer or stack"
            suggestion = suggest_medium(model, list_media_names())
            if hasattr(model, "data_vars"):
                suggestion = "splits.Table(dataset) of the dataset of a table"
            raise invalid("model", shown, "a Table, or a medium", suggestion or hint)
        check_choice("quantity", quantity or "reflectance", ["reflectance"])
        measurement = Measurement.from_input(measured, noise, bands)
        incidence = check_measurement_incidence(fixed, free)
        state_vector = make_medium_state_vector(model, free, prior, incidence)
        fixed_values = {} if INCIDENCE_KEY in state_vector.names else {INCIDENCE_KEY: incidence}
        # Labelled values state it themselves.
        has_label = INCIDENCE_KEY in getattr(measured, "coords", ())
        if fixed_values and not fixed and not has_label:
            note = f"{INCIDENCE_KEY} is not given, {incidence:g} is assumed"
        check_modelled_quantity("measured", measured, "reflectance", fixed_values)
        forward_model = make_medium_model(
            model, measurement, state_vector, incidence, solver, max_stderr, seed, progress,
            max_rays=max_rays, threads=threads, kernel=kernel,
        )  # fmt: skip
        settings = describe_model(model, forward_model.solver)
    if not measurement.noise_known:
        solution, measurement = retrieve_without_noise(forward_model, measurement, seed)
    elif isinstance(forward_model, MediumForwardModel):
        solution = _solve_from_medium(forward_model, measurement, seed)
    else:
        solution = solve_for_known_noise(forward_model, measurement, seed)
    settings |= describe_parameters(state_vector, fixed_values, prior, seed)
    result = make_result(state_vector, measurement, solution, settings)
    if note:
        add_warning(result.dataset, note)
    return result


def _solve_from_medium(model: MediumForwardModel, measurement: Measurement, seed: int) -> Solution:
    """Return the solution from a medium for known noise."""
    converged = model.find_minima()
    linear_model = converged.linearize(model.state_vector, measurement.covariance)
    solution = solve_for_known_noise(linear_model, measurement, seed)
    noise = solution.variance_inflation * (measurement.covariance + converged.model_covariance)
    nonlinearity = estimate_nonlinearity(
        model.evaluate_state,
        linear_model,
        solution.estimates[0].state,
        solution.posterior.covariance,
        noise,
    )
    solution = solution._replace(nonlinearity=nonlinearity)
    alternatives = converged.find_alternatives(ALTERNATIVE_CHI2)
    is_linear = nonlinearity <= MAX_DEVIATION and not alternatives
    if isinstance(model, OrdinatesForwardModel) and not is_linear:
        solution = refine_posterior(
            model.evaluate_state,
            linear_model,
            solution,
            lambda interpolated: solve_for_known_noise(interpolated, measurement, seed),
            alternatives,
        )
    return solution._replace(alternatives=alternatives)
