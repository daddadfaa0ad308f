"""Whole images against a table: a retrieval for every pixel, with errors and flags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.arrays import as_float_array
from splits.core.optional import import_optional
from splits.core.parameter_names import describe_parameter
from splits.core.uncertainty import make_variable
from splits.core.validation import check_choice, invalid, join_names, reject_unknown_arguments
from splits.io.netcdf import ANCILLARY_ATTRIBUTE, make_provenance, to_netcdf_attributes
from splits.retrieval.forward_model import TableForwardModel, get_table_ranges
from splits.retrieval.map_minimization import project_spectra, retrieve_spectra
from splits.retrieval.measurement import MAX_REFLECTANCE, Measurement
from splits.retrieval.state_vector import SCALE, StateVector
from splits.simulation.arguments import check_threads
from splits.tables.table import Table

MAX_COMPONENTS = 24
"""Components that spectra are reduced to, at most."""
MIN_COMPONENT_VARIANCE = 0.01
"""Part of the noise variance of a component below which what it tells is left out."""
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
"""Places in the ranges over which the mean of the table's error is taken."""
RESULT_DIM = "what"
"""Dimension over which results of a pixel lie before they have names."""
CHUNK_PIXELS = 4096
"""Of a piece of work."""
POOR_FIT_PROBABILITY = 1e-3


class _ReducedTable(NamedTuple):
    """A table whose spectra are few numbers, of which noise has variance 1 each.

    Attributes
    ----------
    projection : float, shape (components, wavelengths)
    mean_spectrum : float, shape (wavelengths,)
    node_components : float, shape (cells, components)
    whitening : float, shape (wavelengths, wavelengths)
        Lower triangle.
    """

    projection: np.ndarray
    mean_spectrum: np.ndarray
    node_components: np.ndarray
    whitening: np.ndarray


def _reduce_table(model: TableForwardModel, covariance: np.ndarray) -> _ReducedTable:
    """Return the directions of spectra in which the table tells something, in units of noise."""
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    centre = model.node_values.mean(axis=0)
    cells = (model.node_values - centre) @ white.T
    _, sizes, directions = np.linalg.svd(cells, full_matrices=False)
    # How far the cells scatter along each.
    far = sizes / np.sqrt(len(cells)) > np.sqrt(MIN_COMPONENT_VARIANCE)
    count = min(max(int(far.sum()), len(model.axes)), MAX_COMPONENTS, len(sizes))
    some = directions[:count]
    return _ReducedTable(some @ white, centre, cells @ some.T, white)


@reject_unknown_arguments
def retrieve_map(
    image: xr.DataArray,
    table: Table,
    free: Any,
    noise: Any,
    *,
    fixed: Mapping[str, Any] | None = None,
    prior: Mapping[str, Any] | None = None,
    threads: int | None = None,
) -> xr.Dataset:
    """Retrieve parameters in every pixel of an image.

    Each pixel's most probable values by Gauss and Newton's method in the table, from the nearest of
    its cells, and errors from the curvature there.  `splits.retrieve` does more for one spectrum:
    draws, several starts, and the table's error where the result is; a map takes the mean of that
    over the ranges.

    Parameters
    ----------
    image : xarray.DataArray
        Reflectances over ``wavelength`` (nm) and other dimensions, or over one with a coordinate
        ``wavelength``, such as ``band``; dask arrays block by block.
    table : MethodTable
    free : sequence of str or mapping
        As for `splits.retrieve`, but ``scale``.
    noise : float, array_like or mapping
        Of every pixel, as for `splits.retrieve`.
    at, prior : mapping
        As for `splits.retrieve`.
    threads : int, optional
        Default: every CPU this process may use.

    Returns
    -------
    xarray.Dataset
        Every parameter and its ``…_stderr`` over the image's dimensions; ``chi2``, and what to
        expect of it as its attribute ``expected``; ``flags``, sums of those that the attribute
        ``flag_meanings`` names.  Pixels with gaps, or beyond any reflectance, have NaN and a flag.

    Raises
    ------
    ValueError
        As `splits.retrieve`.
    """
    image = _check_image(image)
    # What no array of this type can hold is told before work begins.
    as_float_array("image", np.empty(0, image.dtype))
    check_choice("quantity", "reflectance", table.quantities)
    which = StateVector.from_ranges(free, prior, get_table_ranges(table))
    if SCALE in which.names:
        raise invalid("free", SCALE, "left out of maps")
    _check_image_names(image, which.names)
    w = image.wavelength.values
    measurement = Measurement.from_input((w, np.full(w.size, 0.5)), noise).check_noise_known()
    model = TableForwardModel(table, measurement, which, fixed)
    random = np.random.default_rng(1)
    own = [
        model.compute_error_covariance(place)
        for place in random.random((N_STATES, len(which.names)))
    ]
    covariance = measurement.covariance + np.mean(own, axis=0)
    work = _MapRetrieval(
        which, model, _reduce_table(model, covariance), covariance, check_threads(threads)
    )
    dims = [d for d in image.dims if d != "wavelength"]
    stacked = image.transpose(*dims, "wavelength")
    if stacked.chunks is not None:
        stacked = stacked.chunk({"wavelength": -1})
    many = 2 * len(which.names) + 2
    found = xr.apply_ufunc(
        work.retrieve_block,
        stacked,
        input_core_dims=[["wavelength"]],
        output_core_dims=[[RESULT_DIM]],
        dask="parallelized",
        output_dtypes=[float],
        dask_gufunc_kwargs={"output_sizes": {RESULT_DIM: many}},
    )
    return _make_dataset(found, which, work)


def _check_image(image: Any) -> xr.DataArray:
    """Return an image whose spectra lie along ``wavelength``, or refuse it."""
    allowed = "a DataArray over wavelength and others"
    if not isinstance(image, xr.DataArray):
        raise invalid("image", type(image).__name__, allowed)
    along: tuple[Any, ...] = image.wavelength.dims if "wavelength" in image.coords else ()
    if len(along) != 1:
        hint = "image.assign_coords(wavelength=('band', […])) gives bands their wavelengths (nm)"
        raise invalid("image", f"over {join_names(map(str, image.dims))}", allowed, hint)
    if not image.size:
        raise invalid("image", "no pixel", "at least one")
    return image if along == ("wavelength",) else image.swap_dims({along[0]: "wavelength"})


def _check_image_names(image: xr.DataArray, names: Sequence[str]) -> None:
    """Reject dimensions and coordinates of an image that are named like results."""
    results = {*names, *(f"{name}_stderr" for name in names), "chi2", "flags", RESULT_DIM}
    for name in map(str, {*image.dims, *image.coords} & results):
        hint = f"image.rename({{{name!r}: 'true_{name}'}}), or leave it out by drop_vars"
        raise invalid("image", f"with {name}", "without names that results have", hint)


class _MapRetrieval(NamedTuple):
    """What all pixels have in common."""

    state_vector: StateVector
    model: TableForwardModel
    reduced_table: _ReducedTable
    covariance: np.ndarray
    threads: int

    def retrieve_block(self, spectra: np.ndarray) -> np.ndarray:
        """Return parameters, errors, misfit and flags of spectra, shape (..., what)."""
        flat = as_float_array("image", spectra, allow_gaps=True).reshape(-1, spectra.shape[-1])
        with ThreadPoolExecutor(self.threads) as pool:
            parts = [flat[i : i + CHUNK_PIXELS] for i in range(0, len(flat), CHUNK_PIXELS)]
            found = np.concatenate(list(pool.map(self._retrieve_chunk, parts)))
        return found.reshape(*spectra.shape[:-1], -1)

    def _retrieve_chunk(self, spectra: np.ndarray) -> np.ndarray:
        free, count = self.state_vector, len(self.state_vector.names)
        gap = ~np.isfinite(spectra).all(axis=1)
        odd = ~gap & (np.abs(np.where(gap[:, None], 0.0, spectra)).max(axis=1) > MAX_REFLECTANCE)
        fine = ~(gap | odd)
        project, centre, cells, white = self.reduced_table
        y, rest = np.empty((len(spectra), len(project))), np.empty(len(spectra))
        # What the components leave no parameter explains.
        project_spectra(
            np.where(fine[:, np.newaxis], spectra, 0.5), centre, project, white, y, rest
        )
        table = self.model.make_grid(cells)
        mean, precision = free.prior_mean, free.prior_precision
        places, variances = np.empty((2, len(y), count))
        misfit = np.empty((len(y), 2))
        known = (mean, precision, free.prior_variance)
        retrieve_spectra(table, y, *known, places, variances, misfit)
        natural = free.to_physical(places)
        near = [np.clip(places + s * np.sqrt(variances), 0.0, 1.0) for s in (-1.0, 1.0)]
        stderr = 0.5 * np.abs(free.to_physical(near[1]) - free.to_physical(near[0]))
        chi2 = misfit[:, 0] + rest
        flags = FLAGS["gap"] * gap + FLAGS["out_of_range"] * odd
        flags = flags + FLAGS["poor_fit"] * (fine & (chi2 > self.compute_max_chi2()))
        flags = flags + FLAGS["not_converged"] * (fine & (misfit[:, 1] == 0.0))
        # An amount of 0 is no end that was set too high.
        ends = (places < 1e-6) & (free.low != 0.0)
        flags = flags + FLAGS["at_lower_bound"] * (fine & ends.any(axis=1))
        flags = flags + FLAGS["at_upper_bound"] * (fine & (places > 1.0 - 1e-6).any(axis=1))
        untold = np.sqrt(variances) > 0.5 * np.sqrt(free.prior_variance)
        flags = flags + FLAGS["unconstrained"] * (fine & untold.any(axis=1))
        found = np.column_stack([natural, stderr, chi2])
        found[~fine] = np.nan
        return np.column_stack([found, flags])

    def compute_max_chi2(self) -> float:
        """Return the misfit that one in a thousand exceeds."""
        chi2 = import_optional("scipy.stats", "retrieval", "retrievals need").chi2

        return float(chi2.isf(POOR_FIT_PROBABILITY, self.compute_expected_chi2()))

    def compute_expected_chi2(self) -> int:
        """Return the misfit to expect."""
        return max(len(self.covariance) - len(self.state_vector.names), 1)


def _make_dataset(
    found: xr.DataArray, state_vector: StateVector, retrieval: _MapRetrieval
) -> xr.Dataset:
    """Return parameters, errors, misfit and flags by name."""
    variables: dict[str, Any] = {}
    dims = tuple(str(d) for d in found.dims[:-1])
    for i, name in enumerate(state_vector.names):
        long_name, units = describe_parameter(name)
        pair = make_variable(
            name,
            dims,
            found[..., i].data,
            found[..., len(state_vector.names) + i].data,
            long_name,
            units,
        )
        variables |= pair
    variables |= make_variable(
        "chi2", dims, found[..., -2].data, None, "sum of squares of the misfit"
    )
    variables["chi2"][2]["expected"] = retrieval.compute_expected_chi2()
    for _, _, about in variables.values():
        # Where values are NaN, flags say why.
        about[ANCILLARY_ATTRIBUTE] = f"{about.get(ANCILLARY_ATTRIBUTE, '')} flags".strip()
    flags = found[..., -1].astype(np.int16)
    told = {
        "long_name": "flags", "units": "1", "flag_masks": np.array(list(FLAGS.values()), np.int16),
        "flag_meanings": " ".join(FLAGS),
    }  # fmt: skip
    variables["flags"] = (dims, flags.data, told)
    facts = {"title": "Map of a retrieval", **make_provenance("map of a retrieval")}
    coordinates = {k: v for k, v in found.coords.items() if k != RESULT_DIM}
    return xr.Dataset(variables, coordinates, to_netcdf_attributes(facts))
