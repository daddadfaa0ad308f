"""Retrieval of medium parameters from the measured return of a light pulse.

The bins of all wavelengths follow each other as channels, which take the place of the wavelengths
of a spectrum.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import (
    as_1d_array,
    as_float_array,
    check_increasing,
    check_no_gaps,
    find_labels,
    match_labels,
)
from splits.core.inputs import Seed
from splits.core.keywords import declare_function
from splits.core.validation import (
    ROUNDING_TOLERANCE,
    as_scalar,
    check_range,
    check_relations,
    invalid,
    short_repr,
)
from splits.illumination.bands import SpectralOperator
from splits.instruments.delay_record import Pulse, PulseInput, describe_record
from splits.retrieval.forward_model import TableModel, get_table_ranges
from splits.retrieval.measurement import Measurement, check_conditions, is_same_label
from splits.retrieval.optimal_estimation import solve_for_known_noise
from splits.retrieval.retrieve import (
    TABLE_SOLVER,
    RetrievalResult,
    add_warning,
    describe_retrieval,
    make_result,
)
from splits.retrieval.state_vector import SCALE, Prior, StateVector
from splits.tables.axes import INCIDENCE
from splits.tables.table import Table

QUANTITY = "return_rate"
UNITS = "s-1"
RETURN_HINT = "a dataset: light.sel(side='reflected') of light = splits.time_of_flight(…)"
MAX_PHOTONS = 1e30
RECORD_ATTRIBUTES = (
    "acceptance_deg", "footprint_radius_m", "pulse_s", "pulse_delay_s", "pulse_power",
)  # fmt: skip
"""Attributes of returns that describe the receiver and the pulse."""


def sort_returns(key: str, dataset: xr.Dataset) -> tuple[xr.Dataset, np.ndarray]:
    """Return a dataset with ascending wavelengths and delays, and the delays between its bins (s).

    Bins must follow each other.
    """
    for dimension in ("wavelength", "delay_s"):
        dataset = dataset.sortby(dimension) if dimension in dataset.indexes else dataset
    bounds = dataset.delay_bounds.transpose("delay_s", ..., missing_dims="ignore")
    dataset, rows = dataset.assign_coords(delay_bounds=bounds), np.atleast_2d(bounds.values)
    follow = np.allclose(rows[1:, 0], rows[:-1, 1], rtol=ROUNDING_TOLERANCE, atol=0.0)
    allowed, hint = "bins that follow each other", "select a slice of the record"
    check_relations((follow, f"{key}.delay_s", "with gaps", allowed, hint))
    return dataset, np.append(rows[:, 0], rows[-1, 1])


def check_return_table(table: Any) -> None:
    """Reject what is not the complete dataset of a table of returns."""
    allowed, names = (
        "what splits.build_table(…, delay_s=…) returned",
        [QUANTITY, f"{QUANTITY}_stderr"],
    )
    attributes = table.attrs if isinstance(table, xr.Dataset) else {}
    is_table = "path_sharing_axes" in attributes and QUANTITY in table
    check_relations((is_table, "table", attributes.get("title", type(table).__name__), allowed))
    for name in (*names, "delay_bounds"):
        check_relations((name in table, f"table.{name}", None, "given", allowed))
    for one in ("wavelength", "delay_s"):
        has_axis = one in table[QUANTITY].dims and one in table.coords
        hint = f"select a list: isel({one}=[0]), which keeps the axis"
        check_relations((has_axis, "table", f"without an axis {one}", allowed, hint))
    check_no_gaps("table", table[names])


def make_channel_table(table: xr.Dataset) -> Table:
    """Return a table of returns with its wavelengths and bins as one axis."""
    stacked = table[[QUANTITY, f"{QUANTITY}_stderr"]].stack(
        channel=("wavelength", "delay_s"), create_index=False
    )
    channels = stacked.drop_vars(["wavelength", "delay_s", "range"], errors="ignore")
    channels = channels.rename(channel="wavelength")
    channels = channels.assign_coords(wavelength=np.arange(channels.sizes["wavelength"]) + 1.0)
    return Table(channels)


def read_return(measured: Any, wavelengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the delays between bins (s) and the light per time, after checking them.

    Parameters
    ----------
    measured : pair of array_like, or xarray.Dataset
        See `splits.retrieve_return`.
    wavelengths : float, shape (wavelengths,)
        Wavelengths of the table (nm).

    Returns
    -------
    edges : float, shape (bins + 1,)
    rates : float, shape (wavelengths, bins)
    """
    if isinstance(measured, xr.Dataset):
        measured = _read_return_dataset(measured)
    if not isinstance(measured, tuple | list) or len(measured) != 2:
        allowed = "(delays between bins in s, light per time in s⁻¹)"
        hint = RETURN_HINT if isinstance(measured, xr.DataArray) else ""
        raise invalid("measured", type(measured).__name__, allowed, hint)
    edges = as_1d_array("measured (delays)", measured[0], "numbers in seconds")
    check_increasing("measured (delays)", edges)
    rates = _align_to_channels(
        "measured", measured[1], edges, wavelengths, "numbers in s⁻¹, without gaps"
    )
    shape = wavelengths.size, edges.size - 1
    is_complete = edges.size > 1 and rates.size == np.prod(shape) and rates.ndim in (1, 2)
    allowed = f"{shape[1]} values for each of the {shape[0]} wavelengths of the table"
    found, hint = f"of shape {rates.shape}", "one fewer than delays"
    check_relations(
        (
            is_complete and rates.shape[-1] in (shape[1], rates.size),
            "measured",
            found,
            allowed,
            hint,
        )
    )
    return edges, rates.reshape(shape)


def _align_to_channels(
    key: str, values: Any, edges: np.ndarray, wavelengths: np.ndarray, allowed: str
) -> np.ndarray:
    """Return numbers in the order of wavelengths and bins.

    Labels are wavelengths (nm), and the middles, the beginnings or the ends of bins (s).
    """
    bins = 0.5 * (edges[1:] + edges[:-1]), edges[:-1], edges[1:]
    labels: dict[str, Any] = {"wavelength": [wavelengths], "delay_s": bins}
    if isinstance(values, xr.DataArray):
        values = values.transpose(*(dim for dim in labels if dim in values.dims), ...)
        check_conditions(key, values, {"wavelength": wavelengths.tolist()})
    numbers = as_float_array(key, values, allowed)
    for axis in range(min(numbers.ndim, 2)):
        name = "delay_s" if axis == numbers.ndim - 1 else "wavelength"
        if isinstance(values, xr.DataArray) and values.dims[axis] in labels:
            name = str(values.dims[axis])
        positions = match_labels(f"{key} ({name})", find_labels(values, axis), labels[name])
        numbers = numbers[(slice(None),) * axis + (positions,)]
    return numbers


def check_return_conditions(
    measured: Any, conditions: Mapping[str, Any], attributes: Mapping[str, Any]
) -> None:
    """Check that a measured return states the conditions of the table.

    Parameters
    ----------
    measured : pair of array_like, or xarray.Dataset
        See `splits.retrieve_return`.
    conditions : mapping
        Incidence, and values of the axes that are not free.
    attributes : mapping
        Those of the table, with those of the pulse, see `describe_record`.
    """
    if not isinstance(measured, xr.Dataset):
        check_conditions("measured", measured[1], conditions)
        return
    stated = {**measured.attrs, **{name: value.values for name, value in measured.coords.items()}}
    light = {INCIDENCE: stated[INCIDENCE]} if stated.get(INCIDENCE) is not None else {}
    check_conditions("measured", measured.assign_coords(light), conditions)
    is_complete = measured.attrs.get("instrument") == "time_of_flight"
    for name in RECORD_ATTRIBUTES:
        own, expected = stated.get(name), attributes.get(name)
        is_stated = name in stated or (is_complete and name in attributes)
        differs = own is None or expected is None or not is_same_label(own, expected)
        allowed = "left out" if expected is None else f"{short_repr(expected)}"
        hint = "as for the table and the argument pulse"
        check_relations((not (is_stated and differs), f"measured.{name}", own, allowed, hint))


def _read_return_dataset(measured: xr.Dataset) -> tuple[np.ndarray, xr.DataArray]:
    """Return the delays between bins and the light per time of `splits.time_of_flight`."""
    is_return = {QUANTITY, "delay_bounds"} <= {*measured.variables}
    allowed = f"with {QUANTITY} and delay_bounds"
    check_relations((is_return, "measured", "a dataset", allowed, RETURN_HINT))
    single = [dim for dim in ("side", "wavelength") if measured.sizes.get(dim) == 1]
    rates = measured.isel(dict.fromkeys(single, 0))[QUANTITY]
    side = (
        "both sides" if "side" in rates.dims else as_scalar(rates.coords.get("side", "reflected"))
    )
    is_record = "delay_s" in rates.dims and not {*rates.dims} - {"wavelength", "delay_s"}
    found = f"{side}, over {', '.join(map(str, rates.dims))}"
    unit = rates.attrs.get("units", UNITS)
    check_relations(
        (
            is_record and side == "reflected", "measured", found,
            "reflected, over wavelength and delay_s", RETURN_HINT,
        ),
        (unit == UNITS, "measured", f"in {unit}", f"in {UNITS}"),
    )  # fmt: skip
    measured, edges = sort_returns("measured", measured)
    rates = measured.isel(dict.fromkeys(single, 0))[QUANTITY]
    # Light is matched by the delays of its bins.
    return edges, rates.drop_vars("delay_s", errors="ignore").transpose(..., "delay_s")


def check_return_noise(
    noise: Any, edges: np.ndarray, wavelengths: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Return the noise of a measured return, and whether photons are counted.

    It is the rate (s⁻¹) of one counted photon in each bin, or the standard error (s⁻¹).

    Parameters
    ----------
    noise : float, array_like or mapping
        See `splits.retrieve_return`.
    edges : float, shape (bins + 1,)
        Delays between bins (s).
    wavelengths : float, shape (wavelengths,)
        Wavelengths of the table (nm).
    """
    shape = wavelengths.size, edges.size - 1
    n_values = int(np.prod(shape))
    allowed = f"standard errors above 0 in s⁻¹, one or {n_values} of them, or {{'photons': …}}"
    check_relations((noise is not None, "noise", None, allowed))
    if isinstance(noise, Mapping):
        check_relations((set(noise) == {"photons"}, "noise", sorted(map(str, noise)), allowed))
        photons = check_range("noise.photons", noise["photons"], 0.0, MAX_PHOTONS, open_low=True)
        return np.tile(1.0 / (photons * np.diff(edges)), shape[0]), True
    stderr = _align_to_channels("noise", noise, edges, wavelengths, allowed)
    is_complete, smallest = stderr.shape in ((), shape, (n_values,)), np.min(stderr, initial=np.inf)
    hint = "noise={'photons': …} also applies to bins without photons"
    check_relations(
        (is_complete, "noise", f"of shape {stderr.shape}", allowed),
        (smallest > 0.0, "noise", float(smallest), allowed, hint),
    )
    return np.broadcast_to(stderr.ravel(), n_values), False


def make_return_operator(table: xr.Dataset, edges: np.ndarray, pulse: Pulse) -> SpectralOperator:
    """Return the operator from the bins of a table to those of a measurement after a pulse.

    Light is uniform within the bins of the table.  The effects of both ways to join pairs of bins,
    divided by 3, give the error, which is proportional to the square of the width.  It is
    proportional to the width, and not divided, for bins of a measurement that are, with the pulse,
    narrower than those of the table.

    Parameters
    ----------
    table : xarray.Dataset
    edges : float, shape (bins + 1,)
        Delays between the bins of the measurement (s).
    pulse : Pulse

    Raises
    ------
    ValueError
        For bins of the measurement that need light outside the record of the table.
    """
    bounds = table.delay_bounds.values
    own_edges = np.append(bounds[:, 0], bounds[-1, 1])
    n_wavelengths, tolerance = table.sizes["wavelength"], ROUNDING_TOLERANCE * own_edges[-1]
    latest = own_edges[-1] + float(pulse.delay_s[0])
    earliest = own_edges[0] + (float(pulse.delay_s[-1]) if own_edges[0] > 0.0 else -np.inf)
    (first, last), key = edges[[0, -1]].tolist(), "measured (delays)"
    hint = "as far as the table goes, minus the length of the pulse"
    check_relations(
        (last <= latest + tolerance, key, last, f"up to {latest:.4g} s", hint),
        (first >= earliest - tolerance, key, first, f"from {earliest:.4g} s", hint),
    )
    matrix = _redistribute(own_edges, edges, pulse)
    largest = np.interp(edges, own_edges[1:], np.diff(own_edges))
    resolved = np.diff(edges) + np.ptp(pulse.delay_s) >= np.maximum(largest[:-1], largest[1:])
    divisor = np.where(resolved, 3.0, 1.0)[:, np.newaxis]
    identity = np.eye(n_wavelengths)
    errors = [
        np.kron(identity, (matrix - _join_pairs(own_edges, edges, pulse, first)) / divisor)
        for first in (0, 1)
    ]
    return SpectralOperator(np.kron(identity, matrix), np.stack(errors))


def _join_pairs(bins: np.ndarray, edges: np.ndarray, pulse: Pulse, first: int) -> np.ndarray:
    """Return the weights of `_redistribute` if light is uniform in pairs of bins from the first."""
    coarse = np.unique(np.concatenate([bins[:1], bins[first::2], bins[-1:]]))
    pair = np.searchsorted(coarse, bins[:-1], side="right") - 1
    fraction = np.diff(bins) / np.diff(coarse)[pair]
    return _redistribute(coarse, edges, pulse)[:, pair] * fraction


def _redistribute(bins: np.ndarray, edges: np.ndarray, pulse: Pulse) -> np.ndarray:
    """Return the weights of rates that are uniform in bins in mean rates between other delays.

    Light from a bin [a, b] at delay u arrives before t with the probability E(t − u), where E is
    the part of the pulse that has been emitted.  Its integral over the bin is G(t − a) − G(t − b),
    with G the integral of E.

    Returns
    -------
    float, shape (other bins, bins)
    """
    delay, emitted = pulse.delay_s, pulse.emitted
    integral = np.zeros(delay.size)
    if delay.size > 1:
        integral[1:] = np.cumsum(0.5 * (emitted[1:] + emitted[:-1]) * np.diff(delay))

    def integrate(time: np.ndarray) -> np.ndarray:
        inside: np.ndarray = np.interp(time, delay, integral)
        return inside + np.maximum(time - delay[-1], 0.0)

    arrived = integrate(edges[:, np.newaxis] - bins[:-1]) - integrate(
        edges[:, np.newaxis] - bins[1:]
    )
    return np.diff(arrived, axis=0) / np.diff(edges)[:, np.newaxis]


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


@declare_function
def retrieve_return(
    measured: Any,
    table: Any,
    free: Any,
    noise: Any,
    *,
    pulse: PulseInput = None,
    fixed: Mapping[str, Any] | None = None,
    prior: Prior = None,
    seed: Seed = 1,
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
    table : Table or xarray.Dataset
        Result of `splits.build_table` with `delay_s`, or a part of its dataset.
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
        As of `splits.retrieve`, with ``measured`` and ``fitted`` over ``wavelength`` and
        ``delay_s``.

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
    >>> table = splits.build_table(
    ...     splits.Snow.natural,
    ...     {"specific_surface_area_m2_kg": [5, 10, 20, 40]},
    ...     1064,
    ...     rays=2000,
    ...     delay_s=delays,
    ... )
    >>> light = table.dataset.return_rate.sel(specific_surface_area_m2_kg=10).squeeze()
    >>> found = splits.retrieve_return(
    ...     (delays, light), table, ["specific_surface_area_m2_kg"], 0.02 * light
    ... )
    >>> found.constrained
    {'specific_surface_area_m2_kg': True}
    """
    table = getattr(table, "dataset", table)
    check_return_table(table)
    table, _ = sort_returns("table", table)
    channels = make_channel_table(table)
    edges, rates = read_return(measured, table.wavelength.values)
    noise_rate, is_counted = check_return_noise(noise, edges, table.wavelength.values)
    record_pulse = Pulse.from_argument(pulse)
    pulse_attributes = describe_record(pulse, None, None)
    state_vector = StateVector.from_ranges(free, prior, get_table_ranges(channels))
    operator = make_return_operator(table, edges, record_pulse)
    _check_rates(rates, edges, noise_rate, is_counted, operator.weights, table, state_vector)
    positions = np.arange(rates.size) + 1.0
    expected, min_count = rates.ravel(), MIN_COUNT
    for _ in range(N_NOISE_UPDATES if is_counted else 1):
        stderr = noise_rate
        if is_counted:
            stderr = np.sqrt(np.maximum(expected / noise_rate, min_count)) * noise_rate
        measurement = Measurement(rates.ravel(), positions, np.diag(stderr**2), {})
        # Rays in different bins are independent.
        model = TableModel(
            channels, measurement, state_vector, fixed, QUANTITY, operator, independent_errors=True
        )
        solution = solve_for_known_noise(model, measurement, seed)
        expected, min_count = solution.estimates[0].modelled, MIN_EXPECTED_COUNT
    conditions = model.list_fixed_values()
    settings = describe_retrieval(
        channels, TABLE_SOLVER, state_vector, conditions, prior, seed,
        quantity=QUANTITY, **pulse_attributes,
    )  # fmt: skip
    check_return_conditions(measured, conditions, {**table.attrs, **pulse_attributes})
    check_conditions("noise", noise, conditions)
    dataset = make_result(state_vector, measurement, solution, settings).dataset
    if pulse is None and solution.variance_inflation > 1.0:
        add_warning(dataset, NO_PULSE)
    return RetrievalResult(_split_channels(dataset, table, edges))


def _check_rates(
    rates: np.ndarray, edges: np.ndarray, noise_rate: np.ndarray, is_counted: bool,
    matrix: np.ndarray, table: xr.Dataset, state_vector: StateVector,
) -> None:  # fmt: skip
    """Reject values that cannot be rates, such as numbers of photons.

    No medium of the table has such values, with any scale: in sum over all bins, their absolute
    values and errors are too small by a factor, or there is much more than the incident light.
    Counted photons are none or at least one, so that their absolute values suffice.

    Parameters
    ----------
    rates : float, shape (wavelengths, bins)
    edges : float, shape (bins + 1,)
    noise_rate, is_counted
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
        table[name].transpose(..., "wavelength", "delay_s").values.reshape(-1, matrix.shape[1])
        for name in (QUANTITY, f"{QUANTITY}_stderr")
    )
    tabulated = np.maximum(node_rates - NODE_ERRORS * error, 0.0) @ matrix.T @ width
    least, most = limits[0] * float(tabulated.min()), limits[1] * len(rates)
    total, uncertainty = float(np.abs(rates).ravel() @ width), float(noise_rate @ width)
    largest = total if is_counted else total + uncertainty
    found = f"of the sum {total:.3g}"
    allowed = "rates in s⁻¹, which have a sum of rate times width of"
    hint = "n of N incident photons in a bin of width w (s) have the value n/(N w)"
    is_too_small = total > 0.0 and largest < least / MAX_DEFICIT
    is_too_large = float(rates.ravel() @ width) > MAX_EXCESS * (most + uncertainty)
    check_relations(
        (not is_too_small, "measured", found, f"{allowed} at least {least:.3g}", hint),
        (not is_too_large, "measured", found, f"{allowed} at most {most:g}", hint),
    )


def _split_channels(dataset: xr.Dataset, table: xr.Dataset, edges: np.ndarray) -> xr.Dataset:
    """Return the dataset of a result with wavelengths and delays instead of channels."""
    shape = table.sizes["wavelength"], edges.size - 1
    variables = {
        name: (
            ("wavelength", "delay_s"), dataset[name].values.reshape(shape),
            {**dataset[name].attrs, "units": UNITS},
        )
        for name in dataset.data_vars
        if "wavelength" in dataset[name].dims
    }  # fmt: skip
    bounds = np.column_stack([edges[:-1], edges[1:]])
    coordinates = {
        "wavelength": table.wavelength,
        "delay_s": ("delay_s", bounds.mean(axis=1), table.delay_s.attrs),
        "delay_bounds": (("delay_s", "bounds"), bounds),
    }
    return dataset.drop_dims("wavelength").assign(variables).assign_coords(coordinates)
