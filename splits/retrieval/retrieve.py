"""Which snow, sand or layer has a measured spectrum, and how sure that is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from splits.checks import known_arguments, one_of, refuse
from splits.instruments.arguments import check_whole
from splits.instruments.progress import Report, shows_progress
from splits.lookup.reading import Table
from splits.retrieval import least_squares
from splits.retrieval.coordinates import Free
from splits.retrieval.estimation import RIVAL, Optimum, optima, optimum, told
from splits.retrieval.forward import OfTable, ranges_of
from splits.retrieval.line import Around, bent
from splits.retrieval.measurement import Measurement
from splits.retrieval.media import free_of, incidence_of, runs_of
from splits.retrieval.posterior import draws_of
from splits.retrieval.result import (
    FAR_FROM_PRIOR,
    Found,
    Retrieved,
    excess_of,
    result_of,
    tension_of,
)
from splits.retrieval.runs import OfRuns


@known_arguments
@shows_progress
def retrieve(
    measured: Any,
    model: Any,
    free: Any,
    noise: Any = None,
    *,
    at: Mapping[str, Any] | None = None,
    prior: Mapping[str, Any] | None = None,
    bands: Any = None,
    quantity: str = "reflectance",
    seed: int = 1,
    max_stderr: float | None = None,
    progress: Report = None,
) -> Retrieved:
    """Retrieve parameters from a measured spectrum, with their errors.

    The most probable values, and draws from the distribution of all that the measurement allows
    (optimal estimation; Rodgers 2000).  In the errors is the noise of the measurement, that of the
    table and what interpolation in it misses.

    Parameters
    ----------
    measured : xarray.DataArray, pandas.Series or pair of array_like
        Reflectances over ``wavelength`` (nm), or (wavelengths, reflectances); a row of them where
        there are `bands`.
    model : Table or medium
        A table of the light to be expected, see `splits.table` and `splits.open_table`; or a snow,
        a sand, a layer or a stack, of which as many runs are made as it takes, some minutes.
    free : sequence of str or mapping
        Axes of the table to be found, or their (low, high) by name.  Of a medium the latter, of
        parameters named as for derivatives (``layers.0.depth_m``).  ``level`` is a factor of
        the model: what was measured is `level` times its light, for a panel whose reflectance is
        not known.
    noise : float, array_like or mapping, optional
        Standard errors of the measurement, one or as many as values, their covariance matrix, or
        ``{"stderr": …, "correlation_nm": …, "independent": …}``: errors that are alike over so
        many nm, and others besides.  Without it the misfit tells how far the values may be off:
        least squares, with errors that are alike at neighbouring values as far as the misfit is.
    at : mapping
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
        and ``value_stderr``, ``mean``, ``determined``, ``quantiles`` over ``quantile``; the
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
    >>> snow = splits.table(
    ...     splits.Snow.natural,
    ...     {"optical_radius_um": [50, 100, 200, 400, 800], "incidence_deg": [50]},
    ...     [860, 1030, 1240],
    ...     max_stderr=0.01,
    ... )
    >>> found = splits.retrieve(
    ...     ([860, 1030, 1240], [0.86, 0.68, 0.51]), splits.Table(snow), ["optical_radius_um"], 0.02
    ... )
    >>> found.determined
    {'optical_radius_um': True}
    """
    seed = check_whole("seed", seed, 0)
    if isinstance(model, Table):
        if max_stderr is not None:
            raise refuse("max_stderr", max_stderr, "left out", "a table has errors of its own")
        one_of("quantity", quantity, model.quantities)
        measurement = Measurement.from_input(measured, noise, bands)
        which = Free.from_ranges(free, prior, ranges_of(model))
        known = OfTable(model, measurement, which, at, quantity)
        if not measurement.noise_known:
            found, measurement = least_squares.in_table(known, measurement, seed)
        else:
            found = _found(known, measurement, seed)
        return result_of(which, measurement, found)
    if isinstance(model, str | Mapping) or not hasattr(model, "kind"):
        given = type(model).__name__
        hint = "splits.Table(splits.table(…)), open_table, or a snow, sand, layer or stack"
        raise refuse("model", given, "a Table, or a medium", hint)
    one_of("quantity", quantity, ["reflectance"])
    measurement = Measurement.from_input(measured, noise, bands)
    beam = incidence_of(at, free)
    which = free_of(model, free, prior, beam)
    runs = runs_of(model, measurement, which, beam, max_stderr, seed, progress)
    if not measurement.noise_known:
        found, measurement = least_squares.by_runs(runs, measurement, seed)
    else:
        found = _by_runs(runs, measurement, seed)
    return result_of(which, measurement, found)


def _by_runs(model: OfRuns, measurement: Measurement, seed: int) -> Found:
    """Return what a measurement of known noise tells by runs."""
    settled = model.find_minima()
    around = Around(model.state_vector, settled.linearize(measurement.covariance))
    found = _found(around, measurement, seed)
    noise = found.variance_inflation * (measurement.covariance + settled.noise_covariance)
    off = bent(model.evaluate_last_stage, around, found.estimates[0].state, found.posterior.covariance, noise)
    return found._replace(nonlinearity=off, alternatives=settled.find_alternatives(RIVAL))


def _found(model: OfTable | Around, measurement: Measurement, seed: int) -> Found:
    """Return the most probable places, and draws around them."""
    free, nodes = model.state_vector, model.evaluate_first_guesses()
    ends = optima(model, measurement, *nodes)
    # A prior that contradicts the measurement is no fault of the model.
    alone = _without_priors(model, measurement, ends[0])
    fair = ends[0] if ends[0].chi2 <= alone.chi2 else alone
    excess = excess_of(fair, free)
    if excess > 1.0:
        ends = optima(model, measurement, *nodes, excess)
    spread = told(alone._replace(error_covariance=excess * alone.error_covariance), free.drop_priors()).covariance
    tension = tension_of(free, alone.state, np.diag(spread))
    if ends[0].chi2 - fair.chi2 / excess < FAR_FROM_PRIOR**2:
        # As well followed with the priors as without: they do not contradict it.
        tension = np.zeros_like(tension)
    draws = draws_of(model, measurement, ends, seed)
    off = np.sqrt(np.diag(model.compute_error_covariance(ends[0].state)))
    return Found(ends, told(ends[0], free), draws, excess, tension, off)


def _without_priors(model: OfTable | Around, measurement: Measurement, estimate: Optimum) -> Optimum:
    """Return the optimum that the measurement has by itself, near that with priors."""
    free = model.state_vector
    if not np.isfinite(free.prior_sd).any():
        return estimate
    model.state_vector = free.drop_priors()
    alone = optimum(model, measurement, estimate.state)
    model.state_vector = free
    return alone
