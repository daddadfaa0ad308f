"""Retrieval of parameter maps from images with a table, with errors and flags.

Compiled descents find the most probable state of every pixel by interpolation of a table.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.arrays import as_float_array, find_labels, match_labels
from splits.core.inputs import Threads
from splits.core.keywords import declare_function
from splits.core.labels import check_nanometres, convert_units
from splits.core.uncertainty import make_variable
from splits.core.validation import InvalidValue, check_relations, invalid, join_names
from splits.illumination.bands import Bands, SpectralBand, check_bands
from splits.io.netcdf import ANCILLARY_ATTRIBUTE, make_provenance, to_netcdf_attributes
from splits.kernels.compiler.jit import entry_point
from splits.kernels.interpolation import interpolate
from splits.media.parameters import describe_parameter
from splits.media.snow_pack_input import FLAG_NAME
from splits.retrieval.forward_model import TableModel, get_table_ranges, select_quantity
from splits.retrieval.measurement import MAX_REFLECTANCE, Measurement, check_modelled_quantity
from splits.retrieval.optimal_estimation import compute_whitening
from splits.retrieval.state_vector import SCALE, Prior, StateVector
from splits.tables.table import Table

MAX_ITERATIONS = 60
"""Largest number of steps of a descent."""
SECOND_START_MARGIN = 0.1
"""Distance from the bounds at which the second descent starts."""
STEP_TOLERANCE = 1e-4
"""Step of the coordinates below which a descent has converged."""


class TableGrid(NamedTuple):
    """Table over coordinates from 0 to 1.

    Attributes
    ----------
    node_values : float64[nodes, columns]
        The last axis runs fastest.  The noise of every column has variance 1.
    axis_nodes : float64[axes, max_nodes]
        Coordinates.
    n_nodes : int64[axes]
    start_states : float64[starts, axes]
        Coordinates at which descents may start.
    start_values : float64[starts, columns]
    mean_spectrum : float64[wavelengths]
    projection : float64[columns, wavelengths]
        From deviations of spectra from the mean to the columns.
    whitening : float64[wavelengths, wavelengths]
        Lower triangular; the noise of whitened spectra has variance 1.
    """

    node_values: np.ndarray
    axis_nodes: np.ndarray
    n_nodes: np.ndarray
    start_states: np.ndarray
    start_values: np.ndarray
    mean_spectrum: np.ndarray
    projection: np.ndarray
    whitening: np.ndarray


@entry_point
def project_spectra(spectra, grid, components, residual_chi2):
    """Set the components of spectra, and the residual sums of squares, in units of noise.

    Parameters
    ----------
    spectra : float64[measurements, wavelengths]
    grid : TableGrid
    components : float64[measurements, columns]
    residual_chi2 : float64[measurements]
    """
    n_wavelengths = spectra.shape[1]
    deviation = np.empty(n_wavelengths)
    for row in range(len(spectra)):
        residual = 0.0
        for i in range(n_wavelengths):
            deviation[i] = spectra[row, i] - grid.mean_spectrum[i]
            total = 0.0
            for j in range(i + 1):
                total += grid.whitening[i, j] * deviation[j]
            residual += total * total
        for component in range(len(grid.projection)):
            total = 0.0
            for i in range(n_wavelengths):
                total += grid.projection[component, i] * deviation[i]
            components[row, component] = total
            residual -= total * total
        residual_chi2[row] = max(residual, 0.0)


@entry_point
def find_best_start(grid, measurement, prior_mean, prior_precision, state):
    """Set the state to the start with the smallest cost."""
    min_cost = np.inf
    for start in range(len(grid.start_states)):
        cost = 0.0
        for a in range(len(state)):
            cost += prior_precision[a] * (grid.start_states[start, a] - prior_mean[a]) ** 2
        for column in range(len(measurement)):
            cost += (grid.start_values[start, column] - measurement[column]) ** 2
        if cost < min_cost:
            min_cost = cost
            state[:] = grid.start_states[start]


@entry_point
def evaluate_cost(grid, measurement, prior, state, modelled, jacobian, gradient, hessian):
    """Return the sum of squares at a state; set half its gradient and half its Hessian."""
    mean, precision = prior
    interpolate(grid.node_values, grid.axis_nodes, grid.n_nodes, state, modelled, jacobian)
    axes = len(state)
    cost = 0.0
    gradient[:] = 0.0
    hessian[:] = 0.0
    for a in range(axes):
        residual = state[a] - mean[a]
        cost += precision[a] * residual * residual
        gradient[a] = precision[a] * residual
        hessian[a, a] = precision[a]
    for column in range(len(measurement)):
        residual = modelled[column] - measurement[column]
        cost += residual * residual
        for a in range(axes):
            gradient[a] += jacobian[column, a] * residual
            for b in range(a + 1):
                hessian[a, b] += jacobian[column, a] * jacobian[column, b]
    for a in range(axes):
        for b in range(a):
            hessian[b, a] = hessian[a, b]
    return cost


@entry_point
def compute_damped_step(state, gradient, hessian, damping, new_state):
    """Set the new state of a damped step within the bounds; coordinates at active bounds stay."""
    axes = len(state)
    at_low, at_high = state <= 0.0, state >= 1.0
    is_fixed = (at_low & (gradient > 0.0)) | (at_high & (gradient < 0.0))
    # The damping is common to all: at 0 of a root transform the own slope would vanish.
    mean_damping = 0.0
    for a in range(axes):
        mean_damping += damping * hessian[a, a] / axes
    for _ in range(axes):
        matrix = np.empty((axes, axes))
        for a in range(axes):
            for b in range(axes):
                matrix[a, b] = 0.0 if is_fixed[a] or is_fixed[b] else hessian[a, b]
            matrix[a, a] = 1.0 if is_fixed[a] else hessian[a, a] + mean_damping + 1e-12
        new_state[:] = state + np.linalg.solve(matrix, np.where(is_fixed, 0.0, -gradient))
        crosses = (at_low & (new_state < 0.0)) | (at_high & (new_state > 1.0))
        blocked = crosses & ~is_fixed
        if not blocked.any():
            break
        is_fixed |= blocked
    new_state[:] = np.minimum(np.maximum(new_state, 0.0), 1.0)


@entry_point
def minimize_levenberg_marquardt(grid, measurement, prior_mean, prior_precision, state, hessian):
    """Minimize the sum of squares from a state by Levenberg and Marquardt; set half the Hessian.

    Returns
    -------
    float, bool
        The sum of squares, and whether the descent has converged.
    """
    axes, columns = len(state), len(measurement)
    values, jacobian = np.empty(columns), np.empty((columns, axes))
    gradient, target = np.empty(axes), np.empty(axes)
    cost = evaluate_cost(
        grid, measurement, (prior_mean, prior_precision), state, values, jacobian, gradient, hessian
    )
    damping = 1e-3
    new_gradient, new_hessian = np.empty(axes), np.empty((axes, axes))
    for _ in range(MAX_ITERATIONS):
        compute_damped_step(state, gradient, hessian, damping, target)
        step_size = np.abs(target - state).max()
        if step_size < STEP_TOLERANCE:
            return cost, True
        new_cost = evaluate_cost(
            grid,
            measurement,
            (prior_mean, prior_precision),
            target,
            values,
            jacobian,
            new_gradient,
            new_hessian,
        )
        if new_cost <= cost:
            cost = new_cost
            state[:] = target
            gradient[:] = new_gradient
            hessian[:] = new_hessian
            damping = max(0.1 * damping, 1e-9)
        else:
            damping = min(10.0 * damping, 1e6)
    return cost, False


@entry_point
def retrieve_spectra(
    grid, measurements, prior_mean, prior_precision, prior_variance, states, variances, misfits
):
    """Retrieve the state of every measurement; set states, variances of coordinates, and misfits.

    Parameters
    ----------
    grid : TableGrid
    measurements : float64[measurements, columns]
    prior_mean, prior_precision : float64[axes]
        Of the priors; precision 0 for parameters without a prior.
    prior_variance : float64[axes]
        Variance of the prior or the range.
    states, variances : float64[measurements, axes]
    misfits : float64[measurements, 2]
        Sum of squares, and 1 if the descent has converged, else 0.
    """
    axes = len(prior_mean)
    hessian, second_hessian = np.empty((axes, axes)), np.empty((axes, axes))
    second_state = np.empty(axes)
    for row in range(len(measurements)):
        state = states[row]
        find_best_start(grid, measurements[row], prior_mean, prior_precision, state)
        # Derivatives may vanish at bounds, so a second descent starts away from them.
        for a in range(axes):
            second_state[a] = min(max(state[a], SECOND_START_MARGIN), 1.0 - SECOND_START_MARGIN)
        cost, converged = minimize_levenberg_marquardt(
            grid, measurements[row], prior_mean, prior_precision, state, hessian
        )
        second_cost, second_converged = minimize_levenberg_marquardt(
            grid, measurements[row], prior_mean, prior_precision, second_state, second_hessian
        )
        if second_cost < cost:
            cost, converged = second_cost, second_converged
            state[:] = second_state
            hessian[:] = second_hessian
        for a in range(axes):
            cost -= prior_precision[a] * (state[a] - prior_mean[a]) ** 2
            # Without a prior, the range provides the prior variance.
            hessian[a, a] += 1.0 / prior_variance[a] - prior_precision[a]
        inverse = np.linalg.inv(hessian)
        for a in range(axes):
            variances[row, a] = inverse[a, a]
        misfits[row, 0] = cost
        misfits[row, 1] = 1.0 if converged else 0.0


MAX_COMPONENTS = 24
"""Largest number of principal components of spectra."""
MIN_COMPONENT_VARIANCE = 0.01
"""Smallest variance of a component over the table, relative to the noise."""
FLAGS = {
    "gap": 1,
    "out_of_range": 2,
    "poor_fit": 4,
    "at_lower_bound": 8,
    "at_upper_bound": 16,
    "unconstrained": 32,
    "not_converged": 64,
}
N_STATES = 32
"""Number of states in the ranges over which the error of the table is averaged."""
RESULT_DIM = "what"
"""Dimension of the results of a pixel before they are split into variables."""
BAND_DIM = "band"
"""Dimension of an image in bands."""
CHUNK_PIXELS = 4096
"""Number of pixels per task."""
POOR_FIT_PROBABILITY = 1e-3


@declare_function
def retrieve_map(
    image: xr.DataArray,
    table: Table,
    free: Any,
    noise: Any,
    *,
    fixed: Mapping[str, Any] | None = None,
    prior: Prior = None,
    bands: Bands = None,
    quantity: str | None = None,
    threads: Threads = None,
) -> xr.Dataset:
    """Retrieve parameters in every pixel of an image.

    The most probable values of each pixel are found by the Gauss-Newton method from the nearest
    node of the table, and their errors from the curvature of the cost.  `splits.retrieve`
    additionally draws from the posterior, uses several starts, and evaluates the error of the
    table at the result; a map uses its mean over the ranges.  As there, the errors of a poor fit
    are increased until its misfit is plausible.

    Parameters
    ----------
    image : xarray.DataArray
        Reflectances over ``wavelength`` (nm) and other dimensions, or over one with a coordinate
        ``wavelength``, in any order; with `bands` over ``band``, in their order or with their
        names as coordinate.  Dask arrays are processed block by block.  Other coordinates, such as
        ``incidence_deg``, must agree with the table.
    table : Table
    free : sequence of str or mapping
        As for `splits.retrieve`, without ``scale``.
    noise : float, array_like or mapping
        Noise of every pixel, as for `splits.retrieve`.
    fixed, prior : mapping
        As for `splits.retrieve`.
    bands : mapping or str
        Bands of the sensor, as for `splits.albedo`.
    quantity : str, optional
        As for `splits.retrieve`.
    threads : int, optional
        By default, all CPUs available to the process.

    Returns
    -------
    xarray.Dataset
        Every parameter and its ``…_stderr`` over the image's dimensions; ``chi2``, and what to
        expect of it as its attribute ``expected``; ``quality_flag``, sums of the flags that its
        attribute ``flag_meanings`` names.  Pixels with gaps, or with invalid reflectances, have NaN
        and a flag.

    Raises
    ------
    ValueError
        For the same arguments as `splits.retrieve`.
    """
    named = {} if bands is None else check_bands(bands)
    image = _check_image(image, named)
    spectral_dim = BAND_DIM if named else "wavelength"
    # Unsupported types are rejected before work begins.
    as_float_array("image", np.empty(0, image.dtype))
    table, quantity, fixed = select_quantity("table", table, quantity, fixed)
    state_vector = StateVector.from_ranges(free, prior, get_table_ranges(table))
    names = state_vector.names
    taken = {*names, *(f"{name}_stderr" for name in names), "chi2", FLAG_NAME, RESULT_DIM}
    check_relations(
        (SCALE not in names, "free", SCALE, "left out of maps"),
        *(
            (
                False, "image", f"with {one}", "without names that results have",
                f"image.rename({{{one!r}: 'true_{one}'}}), or leave it out by drop_vars",
            )
            for one in {*map(str, {*image.dims, *image.coords})} & taken
        ),
        (
            noise is not None, "noise", None, "given",
            "only splits.retrieve estimates it from the misfit",
        ),
    )  # fmt: skip
    # Noise without labels is in the order of the image.
    example = np.full(len(named), 0.5) if named else xr.full_like(image.wavelength, 0.5, float)
    measurement = Measurement.from_input(example, noise, bands)
    image = image if named else image.sortby("wavelength")
    model = TableModel(table, measurement, state_vector, fixed, quantity)
    check_modelled_quantity("image", image, quantity, model.list_fixed_values())
    random = np.random.default_rng(1)
    model_covariances = [
        model.error_covariance(state)
        for state in random.random((N_STATES, len(state_vector.names)))
    ]
    covariance = measurement.covariance + np.mean(model_covariances, axis=0)
    is_lazy = image.chunks is not None
    dims = [dim for dim in image.dims if dim != spectral_dim]
    stacked = image.transpose(*dims, spectral_dim)
    results = xr.apply_ufunc(
        _retrieve_block,
        stacked.chunk({spectral_dim: -1}) if is_lazy else stacked,
        kwargs={
            "model": model, "grid": make_grid(model, covariance), "threads": threads,
            "is_lazy": is_lazy,
        },
        input_core_dims=[[spectral_dim]],
        output_core_dims=[[RESULT_DIM]],
        dask="parallelized",
        output_dtypes=[float],
        dask_gufunc_kwargs={"output_sizes": {RESULT_DIM: 2 * len(names) + 2}},
    )  # fmt: skip
    return _make_dataset(results, state_vector, compute_expected_chi2(model))


def _check_image(image: Any, bands: Mapping[str, SpectralBand]) -> xr.DataArray:
    """Return an image over ``wavelength``, or over ``band`` in the order of bands, if any.

    Invalid images are rejected.  Wavelengths of bands, if any, must be within them.
    """
    allowed = f"a DataArray over {BAND_DIM if bands else 'wavelength'} and others"
    if not isinstance(image, xr.DataArray):
        raise invalid("image", type(image).__name__, allowed)
    dims = f"over {join_names(map(str, image.dims))}"
    own: tuple[Any, ...] = image.wavelength.dims if "wavelength" in image.coords else ()
    n_bands = image.sizes.get(BAND_DIM)
    check_relations(
        (
            not bands or n_bands is not None, "image", dims, allowed,
            "image.rename(…), or leave out bands",
        ),
        (
            bands or len(own) == 1, "image", dims, allowed,
            "bands=… for bands of a sensor; image.assign_coords(wavelength=('spectrum', […]))",
        ),
        (
            not bands or n_bands == len(bands), "image", f"{n_bands} bands",
            f"over {len(bands)}, as many as in bands",
        ),
        (image.size, "image", "no pixel", "at least one"),
    )  # fmt: skip
    if bands:
        labels = find_labels(image, image.get_axis_num(BAND_DIM))
        image = image.isel({BAND_DIM: match_labels(f"image.{BAND_DIM}", labels, [list(bands)])})
    else:
        check_nanometres("image", image.wavelength)
        image = image if own == ("wavelength",) else image.swap_dims({own[0]: "wavelength"})
    by_wavelength = image.wavelength.values.tolist() if bands and own == (BAND_DIM,) else []
    check_relations(
        *(
            (
                band.limits_nm[0] <= wavelength <= band.limits_nm[1], "image.wavelength",
                wavelength, f"within {band} of {name}",
                "is the order of the bands that of the image?",
            )
            for (name, band), wavelength in zip(bands.items(), by_wavelength, strict=False)
        )
    )  # fmt: skip
    return image.copy(data=convert_units("image", image.data, image.attrs.get("units"), "1"))


def _check_block(spectra: np.ndarray, measurement: Measurement) -> None:
    """Reject spectra of which none is valid because of their scale or of a band.

    Gaps alone are no defect.  Pixels that are 0 in all bands, as outside of a scene, say nothing of
    the scale.

    Parameters
    ----------
    spectra : float, shape (pixels, wavelengths)
    measurement : Measurement
        With the bands or wavelengths of the spectra.
    """
    is_number, names = np.isfinite(spectra), [*measurement.bands]
    empty = np.flatnonzero(~is_number.any(axis=0))
    if empty.size and np.count_nonzero(is_number.any(axis=1)) > 1:
        hint = "leave it out: image.dropna('wavelength', how='all')"
        found = f"without a number at {measurement.wavelength_nm[empty[0]]:g} nm"
        if names:
            name = names[empty[0]]
            hint = f"leave {name} out of bands, and of the image: image.dropna('band', how='all')"
            found = f"without a number in band {name}"
        raise invalid("image", found, "numbers in each band", hint)
    spectra = spectra[is_number.all(axis=1) & (spectra != 0.0).any(axis=1)]
    if spectra.size and (np.abs(spectra).max(axis=1) > MAX_REFLECTANCE).all():
        allowed = f"reflectances of at most {MAX_REFLECTANCE:g} in some pixel"
        hint = "fractions, neither per cent nor digital numbers: divide the image by its scale"
        raise invalid("image", f"of the median {np.median(spectra):.4g}", allowed, hint)


def make_grid(model: TableModel, covariance: np.ndarray) -> TableGrid:
    """Return the table of a model on the components that vary more than the noise.

    Parameters
    ----------
    model : TableModel
    covariance : float, shape (wavelengths, wavelengths)
        Of measurement and model.
    """
    whitening = compute_whitening(covariance)
    nodes = model.table_node_values
    mean_spectrum = nodes.mean(axis=0)
    _, singular_values, directions = np.linalg.svd(
        (nodes - mean_spectrum) @ whitening.T, full_matrices=False
    )
    # Significant components have a standard deviation over the nodes above the limit.
    min_value = np.sqrt(MIN_COMPONENT_VARIANCE) * np.sqrt(len(nodes))
    n_significant = max(int((singular_values > min_value).sum()), len(model.axes))
    projection = directions[: min(n_significant, MAX_COMPONENTS)] @ whitening
    states, spectra = model.evaluate_first_guesses()
    node_values, start_values = (
        np.ascontiguousarray((values - mean_spectrum) @ projection.T)
        for values in (model.node_values, spectra)
    )
    states = np.clip(states, 0.0, 1.0)
    return TableGrid(
        node_values, model.axis_nodes, model.n_nodes, states, start_values,
        mean_spectrum, projection, whitening,
    )  # fmt: skip


def compute_expected_chi2(model: TableModel) -> int:
    """Return the expected χ²."""
    return max(model.node_values.shape[1] - len(model.axes), 1)


def _retrieve_block(
    spectra: np.ndarray, model: TableModel, grid: TableGrid, threads: int | None, is_lazy: bool
) -> np.ndarray:
    """Return parameters, errors, misfit and flags of spectra, shape (..., what).

    A defect of a block that is computed later is no error of the image.
    """
    flat = as_float_array("image", spectra, allow_gaps=True).reshape(-1, spectra.shape[-1])
    try:
        _check_block(flat, model.measurement)
    except InvalidValue as defect:
        if not is_lazy:
            raise
        warnings.warn(f"a block of the image has no result: {defect}", stacklevel=2)
    with ThreadPoolExecutor(threads) as pool:
        parts = [flat[i : i + CHUNK_PIXELS] for i in range(0, len(flat), CHUNK_PIXELS)]
        results = list(pool.map(partial(_retrieve_chunk, model, grid), parts))
    return np.concatenate(results).reshape(*spectra.shape[:-1], -1)


def _retrieve_chunk(model: TableModel, grid: TableGrid, spectra: np.ndarray) -> np.ndarray:
    """Return parameters, errors, misfit and flags of spectra, shape (pixels, what)."""
    from scipy.stats import chi2 as chi2_distribution

    state_vector, expected_chi2 = model.state_vector, compute_expected_chi2(model)
    mean, precision = state_vector.prior_mean, state_vector.prior_precision
    prior_variance = state_vector.prior_variance
    has_gap = ~np.isfinite(spectra).all(axis=1)
    # Comparisons with NaN are false.
    is_out_of_range = ~has_gap & (np.abs(spectra) > MAX_REFLECTANCE).any(axis=1)
    is_valid = ~(has_gap | is_out_of_range)
    components = np.empty((len(spectra), len(grid.projection)))
    # No parameter explains the residual of the components.
    residual_chi2 = np.empty(len(spectra))
    project_spectra(
        np.where(is_valid[:, np.newaxis], spectra, 0.5), grid, components, residual_chi2
    )
    states, variances = np.empty((2, len(spectra), len(mean)))
    misfit = np.empty((len(spectra), 2))
    retrieve_spectra(grid, components, mean, precision, prior_variance, states, variances, misfit)
    chi2 = misfit[:, 0] + residual_chi2
    max_chi2 = float(chi2_distribution.isf(POOR_FIT_PROBABILITY, expected_chi2))
    is_poor = is_valid & (chi2 > max_chi2)
    # Larger noise makes the misfit of a poor fit plausible; it does not widen the prior.
    inflation = np.where(is_poor, chi2 / expected_chi2, 1.0)[:, np.newaxis]
    prior_information = 1.0 / prior_variance
    information = (1.0 / variances - prior_information) / inflation
    variances = 1.0 / (information + prior_information)
    low, high = (
        state_vector.to_physical(np.clip(states + sign * np.sqrt(variances), 0.0, 1.0))
        for sign in (-1.0, 1.0)
    )
    # A lower bound of 0 is physical, so no flag is set.
    at_low = (states < 1e-6) & (state_vector.low != 0.0)
    is_unconstrained = np.sqrt(variances) > 0.5 * np.sqrt(prior_variance)
    is_set = {
        "gap": has_gap,
        "out_of_range": is_out_of_range,
        "poor_fit": is_poor,
        "at_lower_bound": is_valid & at_low.any(axis=1),
        "at_upper_bound": is_valid & (states > 1.0 - 1e-6).any(axis=1),
        "unconstrained": is_valid & is_unconstrained.any(axis=1),
        "not_converged": is_valid & (misfit[:, 1] == 0.0),
    }
    stderr = 0.5 * np.abs(high - low)
    results = np.column_stack([state_vector.to_physical(states), stderr, chi2])
    results[~is_valid] = np.nan
    return np.column_stack([results, sum(FLAGS[name] * is_set[name] for name in FLAGS)])


def _make_dataset(
    results: xr.DataArray, state_vector: StateVector, expected_chi2: int
) -> xr.Dataset:
    """Return the dataset of parameters, errors, misfit and flags."""
    variables: dict[str, Any] = {}
    dims = tuple(str(d) for d in results.dims[:-1])
    for i, name in enumerate(state_vector.names):
        long_name, units = describe_parameter(name)
        value, stderr = (results[..., j].data for j in (i, len(state_vector.names) + i))
        variables |= make_variable(name, dims, value, stderr, long_name, units)
    variables |= make_variable(
        "chi2", dims, results[..., -2].data, None, "sum of squares of the misfit"
    )
    variables["chi2"][2]["expected"] = expected_chi2
    for _, _, variable_attributes in variables.values():
        # Flags give the reason of NaN values.
        variable_attributes[ANCILLARY_ATTRIBUTE] = (
            f"{variable_attributes.get(ANCILLARY_ATTRIBUTE, '')} {FLAG_NAME}".strip()
        )
    flags = results[..., -1].astype(np.int16)
    flag_attributes = {
        "long_name": "quality", "units": "1",
        "flag_masks": np.array(list(FLAGS.values()), np.int16),
        "flag_meanings": " ".join(FLAGS),
    }  # fmt: skip
    variables[FLAG_NAME] = (dims, flags.data, flag_attributes)
    attributes = {"title": "Map of a retrieval", **make_provenance("map of a retrieval")}
    coordinates = {k: v for k, v in results.coords.items() if k != RESULT_DIM}
    return xr.Dataset(variables, coordinates, to_netcdf_attributes(attributes))
