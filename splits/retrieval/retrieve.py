"""Retrieval of medium parameters from a measured spectrum, with posterior uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from splits.core.inputs import Kernel, MaxRays, Seed, Solver, StandardError, Threads
from splits.core.keywords import declare_function
from splits.core.progress import ProgressCallback
from splits.core.validation import check_choice, invalid
from splits.illumination.bands import Bands
from splits.instruments.solver import AUTO
from splits.media.formatting import suggest_medium
from splits.media.kinds import list_media_names
from splits.media.parameters import INCIDENCE_KEY
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
from splits.retrieval.optimal_estimation import ALTERNATIVE_CHI2, Solution, solve_for_known_noise
from splits.retrieval.result import (
    TABLE_SOLVER,
    RetrievalResult,
    describe_model,
    describe_parameters,
    make_result,
)
from splits.retrieval.state_vector import StateVector
from splits.tables.table import Table


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
        A table, see `splits.build_table` and `splits.open_table`; or a snow, sand, layer or stack,
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
        0.  For a table with directions, ``polar_deg`` and ``azimuth_deg`` are those of the
        measurement.  A field of view or isotropic light is given by `splits.Table.at_view`.
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
    ...     ([860, 1030, 1240], [0.86, 0.68, 0.51]), splits.Table(snow), ["optical_radius_um"], 0.02
    ... )
    >>> found.constrained
    {'optical_radius_um': True}
    """
    forward_model: TableForwardModel | MediumForwardModel
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
            hint = (
                "splits.Table(splits.build_table(…)), open_table, or a snow, sand, layer or stack"
            )
            suggestion = suggest_medium(model, list_media_names())
            if hasattr(model, "data_vars"):
                suggestion = "splits.Table(dataset) of what splits.build_table returned"
            raise invalid("model", shown, "a Table, or a medium", suggestion or hint)
        check_choice("quantity", quantity or "reflectance", ["reflectance"])
        measurement = Measurement.from_input(measured, noise, bands)
        incidence = check_measurement_incidence(fixed, free)
        state_vector = make_medium_state_vector(model, free, prior, incidence)
        fixed_values = {} if INCIDENCE_KEY in state_vector.names else {INCIDENCE_KEY: incidence}
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
    return make_result(state_vector, measurement, solution, settings)


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
