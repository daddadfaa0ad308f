"""Retrieval of medium parameters from the measured return of a light pulse."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.keywords import reject_unknown_arguments
from splits.core.validation import check_integer, invalid
from splits.instruments.delay_record import Pulse, describe_record
from splits.retrieval.forward_model import get_table_ranges
from splits.retrieval.measurement import check_conditions
from splits.retrieval.result import RetrievalResult, make_result
from splits.retrieval.retrieve import solve_for_known_noise
from splits.retrieval.return_model import (
    QUANTITY,
    UNITS,
    PhotonNoise,
    ReturnForwardModel,
    check_return_conditions,
    check_return_noise,
    make_channel_table,
    make_return_measurement,
    make_return_operator,
    read_return,
    sort_returns,
)
from splits.retrieval.settings import TABLE_SOLVER, describe_model, describe_parameters
from splits.retrieval.state_vector import SCALE, StateVector

N_NOISE_UPDATES = 3
"""Number of solutions with the noise of the photons that the previous one predicts."""
MIN_COUNT, MIN_EXPECTED_COUNT = 1.0, 0.1
"""Smallest numbers of counted and of predicted photons of a bin from which errors follow."""
MAX_DEFICIT, MAX_EXCESS = 1000.0, 100.0
"""Quotients of tabulated and measured light, and of measured and incident light, from which the
measured values are not rates."""
NODE_ERRORS = 3.0
"""Standard errors of the table by which its light may be smaller."""
NO_PULSE = "no pulse is given, so that an instantaneous one is assumed"


@reject_unknown_arguments
def retrieve_return(
    measured: Any,
    table: xr.Dataset,
    free: Any,
    noise: Any,
    *,
    pulse: Any = None,
    fixed: Mapping[str, Any] | None = None,
    prior: Mapping[str, Any] | None = None,
    seed: int = 1,
) -> RetrievalResult:
    """Retrieve parameters from the measured return of a light pulse, with their errors.

    The method is that of `splits.retrieve`.  Errors include the noise of the measurement, the
    errors of the table and those of interpolation in it, over parameters and delays.

    Parameters
    ----------
    measured : pair of array_like, or xarray.Dataset
        (delays between bins, light per time): delays (s) from the centroid of the pulse at the
        surface, and the fraction of the incident light per time (s⁻¹) in each bin, also over the
        wavelengths of the table if it has several.  Or a result of `splits.time_of_flight` on
        the side ``reflected``.  Wavelengths, delays, the incidence, the receiver and the pulse that
        it states must be those of the table and of the other arguments.
    table : xarray.Dataset
        Result of `splits.build_return_table`, or a part of it.
    free : sequence of str or mapping
        Free axes of the table, or their (low, high) by name.  ``scale`` is a factor of the
        modelled return, for light or a receiver of unknown power, from 0.2 to 5.
    noise : float, array_like or mapping
        Standard errors (s⁻¹) of the values, one or as many as values.  For counted photons,
        ``{"photons": N}``, where n photons in a bin of the width w have the value n/(N w); errors
        follow from the number of photons that the result predicts.  Errors from the counted numbers
        would give more weight to bins in which few photons were counted by chance.
    pulse : float or mapping, optional
        As for `splits.time_of_flight`.
    fixed, prior : mapping, optional
        As for `splits.retrieve`.
    seed : int
        Seed of the draws.

    Returns
    -------
    RetrievalResult
        As of `splits.retrieve`, with ``measured`` and ``fitted`` over ``wavelength`` and ``delay``.

    Raises
    ------
    ValueError
        For gaps, noise of 0, delays that the table does not contain, invalid ranges, or values
        that differ from those of the table by a factor of more than a thousand, such as counts.

    Examples
    --------
    >>> import numpy as np
    >>> import splits
    >>> delays = np.array([0, 2e-11, 5e-11, 1e-10, 2e-10, 5e-10])
    >>> table = splits.build_return_table(
    ...     splits.Snow.natural,
    ...     {"specific_surface_area_m2_kg": [5, 10, 20, 40]},
    ...     1064,
    ...     rays=2000,
    ...     delay_s=delays,
    ... )
    >>> light = table.return_rate.sel(specific_surface_area_m2_kg=10).squeeze()
    >>> found = splits.retrieve_return(
    ...     (delays, light), table, ["specific_surface_area_m2_kg"], 0.02 * light
    ... )
    >>> found.constrained
    {'specific_surface_area_m2_kg': True}
    """
    seed = check_integer("seed", seed, 0)
    table = sort_returns(table)
    channels = make_channel_table(table)
    edges, rates = read_return(measured, table.wavelength.values)
    return_noise = check_return_noise(noise, edges, table.wavelength.values)
    record_pulse = Pulse.from_argument(pulse)
    pulse_attributes = describe_record(pulse, None, None)
    state_vector = StateVector.from_ranges(free, prior, get_table_ranges(channels))
    operator = make_return_operator(table, edges, record_pulse)
    _check_rates(rates, edges, return_noise, operator.weights, table, state_vector)
    expected, min_count = rates.ravel(), MIN_COUNT
    for _ in range(N_NOISE_UPDATES if isinstance(return_noise, PhotonNoise) else 1):
        measurement = make_return_measurement(expected, rates, return_noise, min_count)
        forward_model = ReturnForwardModel(
            operator, channels, measurement, state_vector, fixed, QUANTITY
        )
        solution = solve_for_known_noise(forward_model, measurement, seed)
        expected, min_count = solution.estimates[0].modelled, MIN_EXPECTED_COUNT
    settings = describe_model(channels, TABLE_SOLVER) | {"quantity": QUANTITY}
    settings |= pulse_attributes
    settings |= describe_parameters(state_vector, forward_model.list_fixed_values(), prior, seed)
    conditions = forward_model.list_fixed_values()
    check_return_conditions(measured, conditions, {**table.attrs, **pulse_attributes})
    check_conditions("noise", noise, conditions)
    dataset = make_result(state_vector, measurement, solution, settings).dataset
    if pulse is None and solution.variance_inflation > 1.0:
        dataset.attrs["warnings"] += f"; {NO_PULSE}"
    return RetrievalResult(_split_channels(dataset, table, edges))


def _check_rates(
    rates: np.ndarray, edges: np.ndarray, noise: PhotonNoise | np.ndarray, matrix: np.ndarray,
    table: xr.Dataset, state_vector: StateVector,
) -> None:  # fmt: skip
    """Reject values that cannot be rates, such as numbers of photons.

    No medium of the table has such values, with any scale: in sum over all bins, their absolute
    values and errors are too small by a factor, or there is much more than the incident light.
    Counted photons are none or at least one, so that their absolute values suffice.

    Parameters
    ----------
    rates : float, shape (wavelengths, bins)
    edges : float, shape (bins + 1,)
    noise : PhotonNoise or float, shape (wavelengths · bins,)
        See `check_return_noise`.
    matrix : float, shape (wavelengths · bins, channels)
        Weights of the channels of the table in the bins.
    table : xarray.Dataset
    state_vector : StateVector
    """
    limits = (1.0, 1.0)
    if SCALE in state_vector.names:
        number = state_vector.names.index(SCALE)
        limits = float(state_vector.low[number]), float(state_vector.high[number])
    width = np.tile(np.diff(edges), len(rates))
    node_rates, error = (
        table[name].transpose(..., "wavelength", "delay").values.reshape(-1, matrix.shape[1])
        for name in (QUANTITY, f"{QUANTITY}_stderr")
    )
    tabulated = np.maximum(node_rates - NODE_ERRORS * error, 0.0) @ matrix.T @ width
    least, most = limits[0] * float(tabulated.min()), limits[1] * len(rates)
    total = largest = float(np.abs(rates).ravel() @ width)
    if isinstance(noise, PhotonNoise):
        uncertainty = float(noise.count_rate @ width)
    else:
        uncertainty = float(noise @ width)
        largest += uncertainty
    too_small = total > 0.0 and largest < least / MAX_DEFICIT
    if too_small or float(rates.ravel() @ width) > MAX_EXCESS * (most + uncertainty):
        limit = f"at least {least:.3g}" if too_small else f"at most {most:g}"
        allowed = f"rates in s⁻¹, which have a sum of rate times width of {limit}"
        hint = "n of N incident photons in a bin of width w (s) have the value n/(N w)"
        raise invalid("measured", f"of the sum {total:.3g}", allowed, hint)


def _split_channels(dataset: xr.Dataset, table: xr.Dataset, edges: np.ndarray) -> xr.Dataset:
    """Return the dataset of a result with wavelengths and delays instead of channels."""
    names = [name for name in dataset.data_vars if "wavelength" in dataset[name].dims]
    shape = table.sizes["wavelength"], edges.size - 1
    variables = {
        name: (
            ("wavelength", "delay"), dataset[name].values.reshape(shape),
            {**dataset[name].attrs, "units": UNITS},
        )
        for name in names
    }  # fmt: skip
    bounds = np.column_stack([edges[:-1], edges[1:]])
    delay = ("delay", bounds.mean(axis=1), table.delay.attrs)
    coordinates = {
        "wavelength": table.wavelength,
        "delay": delay,
        "delay_bounds": (("delay", "bounds"), bounds),
    }
    return dataset.drop_dims("wavelength").assign(variables).assign_coords(coordinates)
