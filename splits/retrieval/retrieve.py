"""Which snow, sand or layer has a measured spectrum, and how sure that is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from splits.core.progress import ProgressCallback, with_progress
from splits.core.validation import check_choice, invalid, reject_unknown_arguments
from splits.retrieval import least_squares
from splits.retrieval.forward_model import TableForwardModel, get_table_ranges
from splits.retrieval.linearization import LinearizedModel, estimate_nonlinearity
from splits.retrieval.measurement import Measurement
from splits.retrieval.media import (
    check_measurement_incidence,
    make_medium_state_vector,
    make_simulation_model,
)
from splits.retrieval.optimal_estimation import (
    ALTERNATIVE_CHI2,
    MAPEstimate,
    find_distinct_map_estimates,
    find_map_estimate,
    summarize_posterior,
)
from splits.retrieval.posterior import draw_posterior
from splits.retrieval.result import (
    MAX_PRIOR_TENSION,
    RetrievalResult,
    Solution,
    compute_prior_tension,
    compute_variance_inflation,
    make_result,
)
from splits.retrieval.simulation_model import SimulationForwardModel
from splits.retrieval.state_vector import StateVector
from splits.simulation.arguments import check_integer
from splits.tables.table import Table


@reject_unknown_arguments
@with_progress
def retrieve(
    measured: Any,
    model: Any,
    free: Any,
    noise: Any = None,
    *,
    fixed: Mapping[str, Any] | None = None,
    prior: Mapping[str, Any] | None = None,
    bands: Any = None,
    quantity: str = "reflectance",
    seed: int = 1,
    max_stderr: float | None = None,
    progress: ProgressCallback = None,
) -> RetrievalResult:
    """Retrieve parameters from a measured spectrum, with their errors.

    The most probable values, and draws from the distribution of all that the measurement allows
    (optimal estimation; Rodgers 2000).  In the errors is the noise of the measurement, that of the
    table and what interpolation in it misses.

    Parameters
    ----------
    measured : xarray.DataArray, pandas.Series or pair of array_like
        Reflectances over ``wavelength`` (nm), or (wavelengths, reflectances); a row of them where
        there are `bands`.
    model : MethodTable or medium
        A table of the light to be expected, see `splits.build_table` and `splits.open_table`; or a
        snow, a sand, a layer or a stack, of which as many runs are made as it takes, some minutes.
    free : sequence of str or mapping
        Axes of the table to be found, or their (low, high) by name.  Of a medium the latter, of
        parameters named as for derivatives (``layers.0.depth_m``).  ``scale`` is a factor of
        the model: what was measured is `scale` times its light, for a panel whose reflectance is
        not known.
    noise : float, array_like or mapping, optional
        Standard errors of the measurement, one or as many as values, their covariance matrix, or
        ``{"stderr": …, "correlation_nm": …, "independent": …}``: errors that are alike over so
        many nm, and others besides.  Without it the misfit tells how far the values may be off:
        least squares, with errors that are alike at neighbouring values as far as the misfit is.
    fixed : mapping
        Values of the other axes, such as ``incidence_deg``; of a medium that alone.
    prior : mapping
        (mean, standard deviation) of what was known before, by name: normal in the coordinate of
        the parameter, between the two values a standard deviation off.  Without one all of a range
        is as probable, in the coordinate in which light changes evenly: the logarithm of a size,
        the root of an amount.
    bands : mapping or str
        Bands of a sensor in which it was measured, as for `splits.albedo`.
    quantity : str
        Of the table.
    seed : int
        Of the draws, and of runs.
    max_stderr : float, optional
        Of the last runs of a medium; by default half of the least noise, but 0.001 to 0.01, and
        0.002 where noise is not known.
    progress : callable or bool, optional
        See `splits.Progress`; True for a bar.  A table takes no time.

    Returns
    -------
    Retrieved
        Prints what was found.  Its ``dataset`` has, over ``parameter``: ``value`` (most probable)
        and ``value_stderr``, ``mean``, ``constrained``, ``quantiles`` over ``quantile``; the
        ``averaging_kernel`` and the ``correlation``; ``draws``; ``measured`` and ``fitted`` over
        ``wavelength``, with errors.  Attributes: ``rmse``, ``chi2`` and what to expect of it,
        ``degrees_of_freedom`` of signal, ``information_bits``, ``warnings``.

    Raises
    ------
    ValueError
        For gaps, per cent, noise of 0, wavelengths outside of the table, or ranges that cannot be.

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
    seed = check_integer("seed", seed, 0)
    if isinstance(model, Table):
        if max_stderr is not None:
            raise invalid("max_stderr", max_stderr, "left out", "a table has errors of its own")
        check_choice("quantity", quantity, model.quantities)
        measurement = Measurement.from_input(measured, noise, bands)
        which = StateVector.from_ranges(free, prior, get_table_ranges(model))
        known = TableForwardModel(model, measurement, which, fixed, quantity)
        if not measurement.noise_known:
            found, measurement = least_squares.retrieve_from_table(known, measurement, seed)
        else:
            found = _solve(known, measurement, seed)
        return make_result(which, measurement, found)
    if isinstance(model, str | Mapping) or not hasattr(model, "kind"):
        given = type(model).__name__
        hint = "splits.Table(splits.build_table(…)), open_table, or a snow, sand, layer or stack"
        raise invalid("model", given, "a Table, or a medium", hint)
    check_choice("quantity", quantity, ["reflectance"])
    measurement = Measurement.from_input(measured, noise, bands)
    beam = check_measurement_incidence(fixed, free)
    which = make_medium_state_vector(model, free, prior, beam)
    runs = make_simulation_model(model, measurement, which, beam, max_stderr, seed, progress)
    if not measurement.noise_known:
        found, measurement = least_squares.retrieve_by_simulation(runs, measurement, seed)
    else:
        found = _solve_by_simulation(runs, measurement, seed)
    return make_result(which, measurement, found)


def _solve_by_simulation(
    model: SimulationForwardModel, measurement: Measurement, seed: int
) -> Solution:
    """Return what a measurement of known noise tells by runs."""
    settled = model.find_minima()
    around = LinearizedModel(model.state_vector, settled.linearize(measurement.covariance))
    found = _solve(around, measurement, seed)
    noise = found.variance_inflation * (measurement.covariance + settled.noise_covariance)
    off = estimate_nonlinearity(
        model.evaluate_last_stage,
        around,
        found.estimates[0].state,
        found.posterior.covariance,
        noise,
    )
    return found._replace(
        nonlinearity=off, alternatives=settled.find_alternatives(ALTERNATIVE_CHI2)
    )


def _solve(
    model: TableForwardModel | LinearizedModel, measurement: Measurement, seed: int
) -> Solution:
    """Return the most probable places, and draws around them."""
    free, nodes = model.state_vector, model.evaluate_first_guesses()
    ends = find_distinct_map_estimates(model, measurement, *nodes)
    # A prior that contradicts the measurement is no fault of the model.
    alone = _solve_without_priors(model, measurement, ends[0])
    fair = ends[0] if ends[0].chi2 <= alone.chi2 else alone
    excess = compute_variance_inflation(fair, free)
    if excess > 1.0:
        ends = find_distinct_map_estimates(model, measurement, *nodes, excess)
    spread = summarize_posterior(
        alone._replace(error_covariance=excess * alone.error_covariance), free.drop_priors()
    ).covariance
    tension = compute_prior_tension(free, alone.state, np.diag(spread))
    if ends[0].chi2 - fair.chi2 / excess < MAX_PRIOR_TENSION**2:
        # As well followed with the priors as without: they do not contradict it.
        tension = np.zeros_like(tension)
    draws = draw_posterior(model, measurement, ends, seed)
    off = np.sqrt(np.diag(model.compute_error_covariance(ends[0].state)))
    return Solution(ends, summarize_posterior(ends[0], free), draws, excess, tension, off)


def _solve_without_priors(
    model: TableForwardModel | LinearizedModel, measurement: Measurement, estimate: MAPEstimate
) -> MAPEstimate:
    """Return the optimum that the measurement has by itself, near that with priors."""
    free = model.state_vector
    if not np.isfinite(free.prior_sd).any():
        return estimate
    model.state_vector = free.drop_priors()
    alone = find_map_estimate(model, measurement, estimate.state)
    model.state_vector = free
    return alone
