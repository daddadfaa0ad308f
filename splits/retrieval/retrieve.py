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
from splits.core.validation import InvalidValue, check_choice, check_relations, invalid
from splits.illumination.bands import Bands
from splits.instruments.solver import AUTO
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.media.formatting import suggest_medium
from splits.media.kinds import list_media_names
from splits.media.parameters import INCIDENCE_KEY, describe_parameter
from splits.retrieval.forward_model import (
    TableModel,
    drop_priors,
    get_table_ranges,
    select_quantity,
)
from splits.retrieval.linearization import (
    MIN_RESIDUAL_DOF,
    find_table_minima,
    solve_for_unknown_noise,
    solve_near_minima,
)
from splits.retrieval.measurement import Measurement, check_modelled_quantity
from splits.retrieval.medium_model import (
    MediumModel,
    check_measurement_incidence,
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
from splits.retrieval.state_vector import PRIOR, SCALE, Prior, StateVector
from splits.simulation.run_options import make_wavelength_coordinate
from splits.tables.table import Table

FIXED_PREFIX = "fixed_"
"""Beginning of the attributes of fixed values."""
TABLE_SOLVER = "table"
"""Attribute ``solver`` of a retrieval with a table."""


def describe_retrieval(
    model: Any, solver: str, state_vector: StateVector, fixed: Mapping[str, Any],
    prior: Mapping[str, Any] | None, seed: int, **others: Any,
) -> dict[str, Any]:  # fmt: skip
    """Return the attributes of a retrieval: its model, its free and fixed parameters, its seed.

    ``free_NAME`` is the range (low, high), ``prior_NAME`` the prior (mean, standard deviation) as
    given, and ``fixed_NAME`` a fixed value.  Values of free parameters in a medium have no effect.
    """
    attributes = {"solver": solver, **others, "seed": seed}
    if not isinstance(model, Table):
        details = {f"{model.kind}_{key}": value for key, value in model.describe().items()}
        attributes |= {"medium": model.kind, **details}
    elif "medium" in model.dataset.attrs:
        attributes["medium"] = model.dataset.attrs["medium"]
    limits = zip(state_vector.names, state_vector.low, state_vector.high, strict=True)
    attributes |= {f"free_{name}": [float(low), float(high)] for name, low, high in limits}
    attributes |= {f"{FIXED_PREFIX}{name}": value for name, value in fixed.items()}
    for name, pair in (prior or {}).items():
        attributes[f"prior_{name}"] = list(check_named_numbers(f"prior.{name}", pair, PRIOR))
    return attributes


BOUND_DISTANCE = 0.01
"""Distance of a coordinate from a bound below which a value lies at it."""
MAX_NONLINEARITY = 1.0
"""Deviation of linear or interpolated reflectances, in units of noise, which is reported."""


def list_warnings(
    state_vector: StateVector, solution: Solution, constrained: np.ndarray
) -> list[str]:
    """Return the warnings about a result."""
    best, names = solution.estimates[0], state_vector.names
    unconstrained = np.array(names)[~constrained].tolist()
    warnings = [
        text
        for is_shown, text in (
            (
                solution.variance_inflation > 1.0,
                "the model does not fit the measurement within its noise: errors are multiplied by "
                f"{np.sqrt(solution.variance_inflation):.3g}, and may still be too small",
            ),
            (unconstrained, f"not constrained by the measurement: {', '.join(unconstrained)}"),
            *(
                (
                    sigma > MAX_PRIOR_TENSION,
                    f"{name}: prior and measurement are {sigma:.1f} standard deviations apart",
                )
                for name, sigma in zip(names, solution.prior_tension, strict=True)
            ),
        )
        if is_shown
    ]
    for i, name in enumerate(names):
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
    if solution.n_effective < MIN_EFFECTIVE_DRAWS:
        warnings.append(f"quantiles are imprecise: {solution.n_effective:.0f} effective draws")
    return warnings


def _list_alternatives(state_vector: StateVector, solution: Solution) -> list[str]:
    """Return the warnings about distinct alternative solutions."""
    best, *others = (estimate.state for estimate in solution.estimates)
    listed, warnings = [best], []
    for alternative in [*others[:1], *solution.alternatives]:
        difference = alternative - best
        is_within_error = (
            difference @ np.linalg.solve(solution.covariance, difference) < ALTERNATIVE_CHI2
        )
        distances = [np.abs(alternative - state).max() for state in listed]
        if is_within_error or min(distances) < MIN_SEPARATION:
            continue
        listed.append(alternative)
        is_near = np.abs(solution.draws - alternative).max(axis=1) < 0.5 * distances[0]
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
    """Return the result of a retrieval; `settings` are attributes, see `describe_retrieval`.

    The averaging kernel and the information are those of Rodgers (2000), Eqs 2.78 and 2.80.
    """
    best, draws, names = solution.estimates[0], solution.draws, list(state_vector.names)
    value, physical = state_vector.to_physical(best.state), state_vector.to_physical(draws)
    prior_sd = np.sqrt(state_vector.prior_variance)
    constrained = draws.std(axis=0) < UNDETERMINED_FRACTION * prior_sd
    kernel = solution.covariance @ solution.fisher
    scaled = np.eye(len(names)) + solution.fisher * state_vector.prior_variance[:, np.newaxis]
    noise = np.sqrt(np.diag(measurement.covariance))
    parameter_dims, pair_dims = ("parameter",), ("parameter", "other_parameter")
    quantiles = np.quantile(physical, QUANTILES, axis=0)
    with np.errstate(invalid="ignore"):
        correlation = np.nan_to_num(np.atleast_2d(np.corrcoef(draws, rowvar=False)))
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
            kernel * prior_sd / prior_sd[:, np.newaxis],
            None,
            "averaging kernel, in units of the prior standard deviation",
        ),
        **make_variable("correlation", pair_dims, correlation, None, "correlation of coordinates"),
        **make_variable("draws", ("draw", "parameter"), physical, None, "draws from the posterior"),
        **make_variable("measured", "wavelength", measurement.values, noise, "measured"),
        **make_variable(
            "fitted",
            "wavelength",
            best.modelled,
            solution.forward_model_error,
            "of the most probable value",
        ),
    }
    attributes: dict[str, Any] = {
        "title": "Retrieval",
        **settings,
        "rmse": float(np.sqrt(np.mean((best.modelled - measurement.values) ** 2))),
        "noise": NOISE_GIVEN if measurement.noise_known else "found from the misfit",
        "chi2": solution.variance_inflation * best.chi2,
        "chi2_expected": len(best.modelled) - compute_fit_degrees_of_freedom(best, state_vector),
        "error_inflation": float(np.sqrt(solution.variance_inflation)),
        "degrees_of_freedom": float(np.trace(kernel)),
        "information_bits": 0.5 * float(np.linalg.slogdet(scaled)[1]) / float(np.log(2.0)),
        "effective_sample_size": solution.n_effective,
        "warnings": "; ".join(list_warnings(state_vector, solution, constrained)) or "none",
        **make_provenance("retrieval"),
    }
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
    prior: Prior = None,
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
    forward_model: TableModel | MediumModel
    note = ""
    if isinstance(model, Table):
        check_relations(
            (
                max_stderr is None, "max_stderr", max_stderr, "left out",
                "a table has its own errors",
            ),
            (solver == AUTO, "solver", solver, "left out", "a table has its own spectra"),
        )  # fmt: skip
        model, quantity, fixed = select_quantity("model", model, quantity, fixed)
        measurement = Measurement.from_input(measured, noise, bands)
        state_vector = StateVector.from_ranges(free, prior, get_table_ranges(model))
        forward_model = TableModel(model, measurement, state_vector, fixed, quantity)
        fixed_values, others = forward_model.list_fixed_values(), {"quantity": quantity}
        used_solver = TABLE_SOLVER
    else:
        if isinstance(model, str | Mapping) or not hasattr(model, "kind"):
            raise _refuse_model(model)
        check_choice("quantity", quantity or "reflectance", ["reflectance"])
        measurement, others = Measurement.from_input(measured, noise, bands), {}
        incidence = check_measurement_incidence(fixed, free)
        state_vector = make_medium_state_vector(model, free, prior, incidence)
        fixed_values = {} if INCIDENCE_KEY in state_vector.names else {INCIDENCE_KEY: incidence}
        # Labelled values state it themselves.
        if fixed_values and not fixed and INCIDENCE_KEY not in getattr(measured, "coords", ()):
            note = f"{INCIDENCE_KEY} is not given, {incidence:g} is assumed"
        forward_model = MediumModel(
            model, measurement, state_vector, incidence, solver, max_stderr, seed, progress,
            max_rays=max_rays, threads=threads, kernel=kernel,
        )  # fmt: skip
        used_solver = forward_model.solver
    check_modelled_quantity("measured", measured, quantity or "reflectance", fixed_values)
    solution, measurement = _solve(forward_model, measurement, seed)
    settings = describe_retrieval(
        model, used_solver, state_vector, fixed_values, prior, seed, **others
    )
    result = make_result(state_vector, measurement, solution, settings)
    if note:
        add_warning(result.dataset, note)
    return result


def _refuse_model(model: Any) -> InvalidValue:
    """Return the error for what is neither a table nor a medium."""
    shown = model if isinstance(model, str) or callable(model) else type(model).__name__
    hint = "splits.build_table(…), splits.Table(path), or a snow, sand, layer or stack"
    hint = suggest_medium(model, list_media_names()) or hint
    if hasattr(model, "data_vars"):
        hint = "splits.Table(dataset) of the dataset of a table"
    return invalid("model", shown, "a Table, or a medium", hint)


def _solve(
    model: TableModel | MediumModel, measurement: Measurement, seed: int
) -> tuple[Solution, Measurement]:
    """Return the solution, and the measurement with its noise, found from the misfit if unknown."""
    if measurement.noise_known:
        if isinstance(model, TableModel):
            return solve_for_known_noise(model, measurement, seed), measurement
        minima = model.find_minima()
        return solve_near_minima(model, *minima, measurement, seed, model.is_exact), measurement
    n_values, min_values = measurement.values.size, len(model.state_vector.names) + MIN_RESIDUAL_DOF
    if n_values < min_values:
        reason = "values are too few to estimate it from the misfit"
        hint = f"{n_values} {reason}, {min_values} are needed"
        raise invalid("noise", None, "given", hint)
    minima = (
        find_table_minima(drop_priors(model), measurement)
        if isinstance(model, TableModel)
        else drop_priors(model).find_minima()
    )
    return solve_for_unknown_noise(model, *minima, measurement, seed)
