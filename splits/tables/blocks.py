"""Plan of a table, the blocks of its ensembles of paths or solutions, and their assembly."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import netCDF4
import numpy as np
import xarray as xr

from splits.core.inputs import DIFFUSE
from splits.core.progress import ProgressCallback
from splits.core.provenance import hash_physics_sources
from splits.core.uncertainty import ErrorTarget, make_variable
from splits.core.validation import invalid, suggest_name
from splits.discrete_ordinates.applicability import find_direction_obstacle, make_granular_stack
from splits.discrete_ordinates.granular_stack import (
    GranularStack,
    SpectrumSolution,
    solve_with_exponent_error,
)
from splits.illumination.bands import SpectralBand, SpectralOperator
from splits.instruments.angular_estimate import join_wavelengths
from splits.instruments.goniophotometer import make_direction_mask, simulate_directions
from splits.instruments.solver import (
    DISCRETE_ORDINATES,
    MONTE_CARLO,
    PHASE_FUNCTION_FACTOR,
    choose_solver,
    make_estimate,
    solve_angular_distributions,
)
from splits.instruments.spectrophotometer import SpectralRequest
from splits.io.netcdf import (
    append_checksum,
    atomic_netcdf,
    encode_for_netcdf,
    make_provenance,
    to_netcdf_attributes,
)
from splits.kernels.records import N_BATCHES
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.simulation.run_options import make_wavelength_coordinate
from splits.simulation.shared_paths import (
    MAX_SHARED_ROWS,
    PathSharingMedia,
    group_by_shared_paths,
)
from splits.simulation.spectral_tally import QUANTITY_LABELS, SIDE_QUANTITIES
from splits.simulation.strata import STOP_REASONS
from splits.simulation.threads import DaemonThreadPool, limit_blas_threads
from splits.tables.axes import (
    ANGLES,
    DIFFUSE_PREFIX,
    INCIDENCE,
    VIEW_AXES,
    ParameterGrid,
    Views,
    check_quantities,
    has_diffuse,
    list_quantities,
    list_view_axes,
    make_view_coordinates,
    read_views,
)

MAX_VIEW_ROWS = 1000
"""Largest number of rows of one tally of directions, which needs up to 2 GB."""


class PathGroup(NamedTuple):
    """Points of a table that share an ensemble of paths.

    Attributes
    ----------
    incidence : float or "diffuse"
    incidences : tuple
        All incidences of the media in the table.
    path_sharing : PathSharingMedia
        Distinct media of the points.
    positions : int, shape (points,)
        Flat indices of the points in the table, or in the grid of its media where the table has
        other incidences.
    media_indices : int, shape (points,)
        Index of the medium of each point.
    """

    incidence: float | str
    incidences: tuple[float | str, ...]
    path_sharing: PathSharingMedia
    positions: np.ndarray
    media_indices: np.ndarray


class TablePlan(NamedTuple):
    """Plan of all ensembles of a table, and the settings of their simulation.

    Attributes
    ----------
    grid : ParameterGrid
        Axes of the points, without directions of observation.
    request : SpectralRequest
        Request for spectra; each ensemble sets its own incidence.
    quantities : tuple of str
        See `splits.tables.axes.check_quantities`.
    covariance : bool
        Whether deviations by batch of rays are stored.
    views : tuple of array or None
        Polar angles and azimuths of observation.
    path_groups : tuple of PathGroup
    path_sharing_axes : tuple of str
        Axes along which all points share paths.
    solver : {"monte_carlo", "discrete_ordinates"}
    """

    grid: ParameterGrid
    request: SpectralRequest
    quantities: tuple[str, ...]
    covariance: bool
    views: Views | None
    path_groups: tuple[PathGroup, ...]
    path_sharing_axes: tuple[str, ...]
    solver: str = MONTE_CARLO

    @classmethod
    def from_grid(
        cls,
        make_medium: Callable[..., Any],
        grid: ParameterGrid,
        request: SpectralRequest,
        incidence_deg: float | str = 0.0,
        quantities: Sequence[str] | None = None,
        *,
        covariance: bool = False,
    ) -> TablePlan:
        """Return the plan of a table, by paths; see `choose_table_solver`.

        Parameters
        ----------
        make_medium : callable
            Function of the parameters of a point, without the incidence, that returns a medium.
        grid : ParameterGrid
            All axes, with directions of observation.
        request : SpectralRequest
        incidence_deg : float or "diffuse"
            Incidence, unless it is an axis of the grid.
        quantities, covariance
            As for `splits.build_table`.

        Raises
        ------
        ValueError
            For an invalid point; the message names it.
        """
        views = read_views(grid)
        selected = check_quantities(quantities, views, covariance)
        grid = grid.drop(*VIEW_AXES)
        beams = grid.get_incidences(incidence_deg)
        media_axes = grid.drop(INCIDENCE)
        media = [make_point_medium(make_medium, point) for point in media_axes.iterate_points()]
        with_diffuse = has_diffuse(selected)
        if with_diffuse and DIFFUSE in beams:
            raise invalid(INCIDENCE, DIFFUSE, "angles with quantities under isotropic light")
        max_rows = MAX_SHARED_ROWS if views is None else MAX_VIEW_ROWS
        media_groups = group_by_shared_paths(media, request.wavelengths, max_rows)
        incidences = (*beams, *([DIFFUSE] if with_diffuse else []))
        positions = np.arange(grid.size).reshape(grid.shape)
        if INCIDENCE in grid:
            positions = np.moveaxis(positions, list(grid).index(INCIDENCE), -1)
        positions = positions.reshape(len(media), len(beams))
        path_groups = tuple(
            PathGroup(beam, incidences, group.path_sharing, rows, group.media_indices)
            for group in media_groups
            for beam, rows in [
                *zip(beams, positions[group.positions].T, strict=True),
                *([(DIFFUSE, group.positions)] if with_diffuse else []),
            ]
        )
        # All points along an axis share paths if the number of their group does not change.
        numbers = np.empty(media_axes.size, dtype=int)
        for number, group in enumerate(media_groups):
            numbers[group.positions] = number
        numbers = numbers.reshape(media_axes.shape)
        sharing_axes = tuple(
            name
            for axis, (name, row) in enumerate(media_axes.items())
            if len(row) > 1 and (numbers == np.take(numbers, [0], axis=axis)).all()
        )
        return cls(grid, request, selected, covariance, views, path_groups, sharing_axes)

    def list_variables(self) -> dict[str, dict[str, int]]:
        """Return the variables of the table by name, with the sizes of their dimensions.

        The dimensions are batches, the axes of the points, and directions and wavelengths.
        """
        views = (
            {} if self.views is None else dict(zip(VIEW_AXES, map(len, self.views), strict=True))
        )
        variables = {}
        for quantity in self.quantities:
            is_diffuse = quantity.startswith(DIFFUSE_PREFIX)
            grid = self.grid.drop(INCIDENCE) if is_diffuse else self.grid
            sizes = dict(zip(grid, grid.shape, strict=True))
            sizes |= {name: views[name] for name in list_view_axes(quantity)}
            sizes["wavelength"] = self.request.wavelengths.size
            for suffix in ("", "_stderr"):
                variables[quantity + suffix] = sizes
            if self.covariance:
                variables[f"{quantity}_batches"] = {"batch": N_BATCHES, **sizes}
        return variables

    def list_media(self) -> list[Medium]:
        """Return the distinct media of all points."""
        groups = {id(group.path_sharing): group.path_sharing for group in self.path_groups}
        return [medium for path_sharing in groups.values() for medium in path_sharing.media]

    def select_part(self, part: int, n_parts: int) -> tuple[PathGroup, ...]:
        """Return the ensembles of one of several parts.

        Discrete ordinates solve all angles of incidence of a medium together, which are therefore
        in one part.
        """
        n_media_groups = len({id(one.path_sharing) for one in self.path_groups})
        n_beams = (
            len(self.path_groups) // n_media_groups if self.solver == DISCRETE_ORDINATES else 1
        )
        numbered = enumerate(self.path_groups)
        return tuple(one for number, one in numbered if number // n_beams % n_parts == part)

    def __str__(self) -> str:
        """Return a one-line summary of the plan."""
        n_groups, shared = len(self.path_groups), self.path_sharing_axes
        axes = f" ({', '.join(shared)})" if shared else ""
        return (
            f"{len(shared)} of {len(self.grid)} axes share paths{axes}: "
            f"{n_groups} ensemble{'s' if n_groups > 1 else ''} "
            f"for {self.grid.size} spectra of {self.request.wavelengths.size} wavelengths"
        )


def choose_table_solver(
    solver: Any, media: Iterable[Medium], wavelengths: np.ndarray, covariance: bool,
    max_stderr: float = np.inf, has_views: bool = False,
) -> str:  # fmt: skip
    """Return the solver for all media of a table, see `splits.instruments.solver.choose_solver`."""
    return choose_solver(
        solver, media, wavelengths, max_stderr=max_stderr,
        obstacle="a covariance needs batches of rays" if covariance else None,
        find_further_obstacle=lambda one: find_direction_obstacle(one) if has_views else None,
    ).solver  # fmt: skip


def make_point_medium(
    make_medium: Callable[..., Any], point: dict[str, Any],
    check: Callable[[Any], None] = lambda medium: None,
) -> Medium:  # fmt: skip
    """Return the medium of a point of the grid, after a further check; errors name the point."""
    try:
        medium: Medium = make_medium(**point)
        check_medium(medium, allow_semi_infinite=True)
        check(medium)
    except (ValueError, TypeError) as error:
        given = ", ".join(f"{name} = {value!r}" for name, value in point.items())
        key, allowed, hint = "grid", "a medium", str(error)
        for name in reversed([*point]) if isinstance(error, TypeError) else ():
            # The medium does not take an axis whose name is a synonym of an angle.
            synonym = suggest_name(name, ANGLES)
            if synonym and name in str(error) and "did you mean" not in str(error):
                key, given, hint = f"grid.{name}", point[name], synonym
                allowed = "a parameter of the medium, or an angle"
        raise invalid(key, given, allowed, hint) from None
    return medium


def prepare_media(group: PathGroup, plan: TablePlan) -> Any:
    """Return what the media of a group have in common under all incidences, for `compute_block`.

    Paths have the truncation of semi-infinite media in common; discrete ordinates solve each medium
    for all incidences at once.
    """
    request, media = plan.request, group.path_sharing.media
    if plan.solver == MONTE_CARLO:
        return request.truncate(group.path_sharing)
    wavelengths, max_stderr, threads = request.wavelengths, request.max_stderr, request.run.threads
    # Paths through grains use all threads themselves.
    error = max_stderr * (1.0 if plan.views is None else PHASE_FUNCTION_FACTOR)
    stacks = [make_granular_stack(medium, wavelengths, error, threads) for medium in media]
    if plan.views is not None:
        target = _make_target(plan.views)
        return [
            solve_angular_distributions(one, *plan.views, max_stderr, target, group.incidences)
            for one in stacks
        ]
    angles = [float(incidence) for incidence in group.incidences if incidence != DIFFUSE]
    cosines = np.cos(np.radians(angles))

    def solve(stack: GranularStack) -> SpectrumSolution:
        return solve_with_exponent_error(stack, cosines, max_stderr)

    # The error determines the number of streams.
    with limit_blas_threads(), DaemonThreadPool(threads) as pool:
        return list(pool.map(solve, stacks))


def compute_block(
    group: PathGroup, plan: TablePlan, prepared: Any, progress: ProgressCallback = None
) -> xr.Dataset:
    """Compute a block: values and standard errors over ``point``, views and ``wavelength``.

    Parameters
    ----------
    group : PathGroup
    plan : TablePlan
    prepared : object
        From `prepare_media`, for the media of the group.
    progress : callable, optional
    """
    start_time = time.perf_counter()
    run = plan.request.run._replace(progress=progress)
    request = plan.request._replace(incidence=group.incidence, run=run)
    compute = _compute_spectra if plan.views is None else _compute_directions
    variables, described = compute(group, plan._replace(request=request), prepared)
    attrs = {
        **make_provenance("block of a table"),
        **described,
        "wall_time_s": round(time.perf_counter() - start_time, 3),
    }
    point_coordinate = ("point", group.positions, {"long_name": "flat index in the table"})
    return xr.Dataset(
        variables, {"point": point_coordinate, "wavelength": request.wavelengths}, attrs
    )


def _compute_spectra(
    group: PathGroup, plan: TablePlan, prepared: Any
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the variables of a block of spectra, and its attributes."""
    request = plan.request
    if plan.solver == DISCRETE_ORDINATES:
        # Isotropic light is the last column of a solution.
        beams = [incidence for incidence in group.incidences if incidence != DIFFUSE]
        column = -1 if group.incidence == DIFFUSE else beams.index(group.incidence)
        estimate = make_estimate(prepared, column)
    else:
        estimate = request.simulate(group.path_sharing, prepared)
    shape = (len(group.path_sharing.media), request.wavelengths.size)
    variables: dict[str, Any] = {}
    for side in plan.quantities:
        row = SIDE_QUANTITIES.index(side)
        for name, array in ((side, estimate.mean), (f"{side}_stderr", estimate.stderr)):
            values = array[row].reshape(shape)[group.media_indices]
            variables[name] = (("point", "wavelength"), values.astype(np.float32))
        if plan.covariance:
            deviations = estimate.batch_deviations[:, row].reshape(N_BATCHES, *shape)
            variables[f"{side}_batches"] = (
                ("batch", "point", "wavelength"),
                deviations[:, group.media_indices].astype(np.float32),
            )
    return variables, {
        **estimate.rays,
        "max_stderr_reached": float(estimate.stderr.max()),
        "interpolation_error_bound": float(estimate.interpolation_error.max()),
        "stop_reason": estimate.get_stop_reason(request.max_stderr, request.max_rays),
    }


def _compute_directions(
    group: PathGroup, plan: TablePlan, prepared: Any
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the variables of a block with directions of observation, and its attributes.

    Rows of the estimate are the wavelengths of one medium after the other.
    """
    request, views = plan.request, plan.views
    assert views is not None
    if plan.solver == DISCRETE_ORDINATES:
        column = group.incidences.index(group.incidence)
        results = [by_incidence[column] for by_incidence in prepared]
        estimate = join_wavelengths([estimate for estimate, _ in results])
        attributes = {"rays": 0} | {
            name: max(described[name] for _, described in results)
            for name in ("streams", "truncation_error", "optics_error")
        }
        otherwise = "solver_error"
    else:
        estimate, rays, stop_reason = simulate_directions(
            group.path_sharing, prepared, request, *views, _make_target(views)
        )
        attributes = {"rays": rays}
        # With enough rays, only light from below a truncation depth leaves a larger error.
        otherwise = "interpolation_bound" if stop_reason == "converged" else stop_reason
    reached = estimate.compute_max_error(_make_target(views))
    attributes |= {
        "max_stderr_reached": reached,
        "stop_reason": "converged" if reached <= request.max_stderr else otherwise,
        "interpolation_error_bound": 0.0,
    }
    values = {
        "reflectance": (estimate.hemispherical[0], estimate.hemispherical_stderr[0]),
        "reflectance_factor": (np.pi * estimate.mean[0], np.pi * estimate.stderr[0]),
        "anisotropy_factor": (estimate.anisotropy, estimate.anisotropy_stderr),
    }
    is_diffuse = group.incidence == DIFFUSE and has_diffuse(plan.quantities)
    prefix = DIFFUSE_PREFIX if is_diffuse else ""
    variables: dict[str, Any] = {}
    for name in plan.quantities:
        if name.startswith(DIFFUSE_PREFIX) != is_diffuse:
            continue
        axes = list_view_axes(name)
        n_media, n_wavelengths = len(group.path_sharing.media), request.wavelengths.size
        shape = (n_media, n_wavelengths, *(map(len, views) if axes else ()))
        for suffix, array in zip(("", "_stderr"), values[name.removeprefix(prefix)], strict=True):
            by_medium = np.moveaxis(array.reshape(shape), 1, -1)[group.media_indices]
            if axes != VIEW_AXES and axes:
                # Under isotropic light, all azimuths are equal.
                by_medium = by_medium[:, :, 0]
            dims = ("point", *axes, "wavelength")
            variables[name + suffix] = (dims, by_medium.astype(np.float32))
    return variables, attributes


def _make_target(views: Views) -> ErrorTarget:
    """Return the target of absolute errors of reflectance factors."""
    return ErrorTarget(0, make_direction_mask(*views), absolute=True)


LABELS = {
    **QUANTITY_LABELS,
    "reflectance_factor": "bidirectional reflectance factor",
    "anisotropy_factor": "anisotropy factor",
    "diffuse_reflectance": "bihemispherical reflectance",
    "diffuse_reflectance_factor": "hemispherical-directional reflectance factor",
    "diffuse_anisotropy_factor": "anisotropy factor under isotropic light",
}


def assemble_blocks(plan: TablePlan, blocks: Iterable[xr.Dataset]) -> xr.Dataset:
    """Return a table as a dataset from its blocks, which are computed meanwhile."""
    start_time = time.perf_counter()
    block_attrs, arrays = [], {
        name: np.full(tuple(sizes.values()), np.nan, np.float32)
        for name, sizes in plan.list_variables().items()
    }  # fmt: skip
    for block in blocks:
        for name, variable in block.data_vars.items():
            axis = variable.dims.index("point")
            sizes = variable.shape
            by_point = arrays[str(name)].reshape(*sizes[:axis], -1, *sizes[axis + 1 :])
            by_point[(*[slice(None)] * axis, block.point.values)] = variable.values
        block_attrs.append(block.attrs)
    return _make_dataset(arrays, plan, block_attrs, time.perf_counter() - start_time)


def _make_dataset(
    arrays: Mapping[str, np.ndarray],
    plan: TablePlan,
    block_attrs: Sequence[Mapping[str, Any]],
    wall_time_s: float,
) -> xr.Dataset:
    """Return a table as a dataset from its arrays and the attributes of its blocks."""
    variables = {}
    is_diffuse = plan.path_groups[0].incidence == DIFFUSE
    for name, sizes in plan.list_variables().items():
        quantity = name.removesuffix("_stderr").removesuffix("_batches")
        label = LABELS[quantity]
        if quantity == "reflectance_factor" and is_diffuse:
            label = LABELS[DIFFUSE_PREFIX + quantity]
        attrs = {"long_name": label, "units": "1", "ancillary_variables": f"{quantity}_stderr"}
        if name != quantity:
            kind = "standard error" if name.endswith("_stderr") else "deviation by batch of rays"
            attrs = {"long_name": f"{kind} of {label}", "units": "1"}
        variables[name] = (tuple(sizes), arrays[name], attrs)
    coordinates = {
        **plan.grid.to_coordinates(),
        **({} if plan.views is None else make_view_coordinates(plan.views)),
        "wavelength": make_wavelength_coordinate(plan.request.wavelengths),
    }
    media = plan.list_media()
    described = [{f"{m.kind}_{key}": v for key, v in m.describe().items()} for m in media]
    common = {
        key: value
        for key, value in described[0].items()
        if all(key in one and np.array_equal(one[key], value) for one in described)
    }
    if INCIDENCE not in plan.grid:
        common[INCIDENCE] = plan.path_groups[0].incidence
    dataset_attrs: dict[str, Any] = {
        "title": f"Table of {plan.grid.size} spectra",
        "path_sharing_axes": ", ".join(plan.path_sharing_axes) or "none",
        "max_stderr": plan.request.max_stderr,
        "max_stderr_reached": max(float(block["max_stderr_reached"]) for block in block_attrs),
        "interpolation_error_bound": max(
            float(block["interpolation_error_bound"]) for block in block_attrs
        ),
        "stop_reason": max(
            (str(block["stop_reason"]) for block in block_attrs), key=STOP_REASONS.index
        ),
        "solver": plan.solver,
        "seed": plan.request.run.seed,
        "rays": int(sum(int(block["rays"]) for block in block_attrs)),
        "ensembles": len(plan.path_groups),
        "wall_time_s": round(wall_time_s, 3),
        "physics_sources_sha256": hash_physics_sources(),
        "medium": media[0].kind,
        **common,
        **make_provenance("table"),
    }
    return xr.Dataset(variables, coordinates, to_netcdf_attributes(dataset_attrs))


def average_nodes(
    table: xr.Dataset, bands: Mapping[str, SpectralBand], matrix: SpectralOperator
) -> xr.Dataset:
    """Return a table with its means over bands at all nodes, and their errors."""
    axes = {"band": list(bands), "wavelength": table.wavelength}
    weights = xr.DataArray(matrix.weights, axes, list(axes))
    error_weights = xr.DataArray(matrix.error_weights, axes, ("estimate", *axes))
    variables: dict[str, Any] = {}
    for quantity in list_quantities(table):
        mean, error = table.errors.weighted_sum(quantity, weights)
        between = (error_weights * table[quantity]).sum("wavelength")
        error = (error**2 + (between**2).sum("estimate")) ** 0.5
        dims = tuple("band" if dim == "wavelength" else str(dim) for dim in table[quantity].dims)
        values, stderr = (one.transpose(*dims).values.astype(np.float32) for one in (mean, error))
        label = f"{table[quantity].attrs['long_name']} over a band"
        variables |= make_variable(f"band_{quantity}", dims, values, stderr, label)
    digests = {f"band_{name}_sha256": one.sha256 for name, one in bands.items() if one.sha256}
    return table.assign(variables).assign_coords(band=list(bands)).assign_attrs(digests)


def compute_table_bytes(plan: TablePlan) -> int:
    """Return the size of the values of a table in bytes."""
    sizes = (math.prod(one.values()) for one in plan.list_variables().values())
    return np.dtype(np.float32).itemsize * sum(sizes)


def write_table_blockwise(
    path: Path,
    plan: TablePlan,
    read_blocks: Callable[[], Iterable[xr.Dataset]],
    add_attributes: Callable[[xr.Dataset], xr.Dataset],
) -> None:
    """Write a table to a netCDF file atomically, one block at a time.

    At most one block of values is in memory.  Values are stored uncompressed in the order of the
    axes, so that single spectra can be read.

    Parameters
    ----------
    path : Path
    plan : TablePlan
    read_blocks : callable
        Returns an iterable of the blocks; called several times.
    add_attributes : callable
        Returns a dataset with additional attributes.

    Raises
    ------
    OSError
        If the disk is full, or the file does not hold the blocks afterwards.
    """
    with atomic_netcdf(path, compute_table_bytes(plan)) as temporary:
        variables = plan.list_variables()
        # Broadcast values use no memory.
        empty = {
            name: np.broadcast_to(np.float32(np.nan), tuple(sizes.values()))
            for name, sizes in variables.items()
        }
        attrs = [block.attrs for block in read_blocks()]
        seconds = sum(float(one["wall_time_s"]) for one in attrs)
        table = _make_dataset(empty, plan, attrs, seconds)
        skeleton = encode_for_netcdf(add_attributes(table))
        skeleton.drop_vars(list(variables)).to_netcdf(temporary, engine="netcdf4")
        with netCDF4.Dataset(temporary, "a") as file:
            for name in variables:
                # Without writing its values.
                variable = skeleton[name]
                dims = [str(dim) for dim in variable.dims]
                for dim, size in zip(dims, variable.shape, strict=True):
                    if dim not in file.dimensions:
                        file.createDimension(dim, size)
                created = file.createVariable(name, "f4", dims, fill_value=False, contiguous=True)
                created.setncatts(variable.attrs)
                auxiliary = [str(c) for c in variable.coords if c not in variable.dims]
                if auxiliary:
                    created.coordinates = " ".join(auxiliary)
            for name, index, values in _iterate_points(plan, read_blocks()):
                file.variables[name][index] = values
        with netCDF4.Dataset(temporary) as file:
            file.set_auto_maskandscale(False)
            complete = all(
                np.array_equal(file.variables[name][index], values)
                for name, index, values in _iterate_points(plan, read_blocks())
            )
        if not complete:
            raise OSError(f"{path}: the file written does not hold the table")
        append_checksum(temporary)


def _iterate_points(
    plan: TablePlan, blocks: Iterable[xr.Dataset]
) -> Iterator[tuple[str, tuple[Any, ...], np.ndarray]]:
    """Yield the name of a variable, the index in the table, and the values, of each point."""
    variables = plan.list_variables()
    for block in blocks:
        for name, values in block.data_vars.items():
            sizes = variables[str(name)]
            shape = [sizes[axis] for axis in sizes if axis in plan.grid]
            leading = (slice(None),) * ("batch" in sizes)
            for row, position in enumerate(block.point.values):
                index = np.unravel_index(position, shape)
                yield str(name), (*leading, *map(int, index)), values.isel(point=row).values
