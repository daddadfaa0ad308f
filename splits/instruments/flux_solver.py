"""Fluxes inside layers of grains by discrete ordinates, in the form of simulations."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from splits.core.uncertainty import Variable, make_deviation_variable, make_variable
from splits.core.validation import ROUNDING_TOLERANCE
from splits.discrete_ordinates.applicability import make_granular_stack
from splits.discrete_ordinates.granular_stack import GranularStack
from splits.discrete_ordinates.profiles import (
    IntervalProfile,
    LayerDivision,
    ProfileSolution,
    solve_profile,
)
from splits.instruments.flux_dataset import (
    ACTINIC_LABEL,
    MATERIAL_LABEL,
    QUANTITIES,
    make_flux_coordinates,
)
from splits.instruments.solver import DISCRETE_ORDINATES
from splits.kernels.tallies.exits import N_BATCHES
from splits.media.medium import Medium
from splits.simulation.threads import limit_blas_threads


def solve_flux(
    medium: Medium, wavelengths: np.ndarray, depths: np.ndarray, incidence: float | str,
    max_stderr: float, limit_irradiance: bool, threads: int,
) -> xr.Dataset:  # fmt: skip
    """Return the dataset of `splits.irradiance_profile`, with the attributes of the solution.

    Parameters
    ----------
    medium : Medium
        Without obstacle.
    wavelengths, depths : float, shape (wavelengths,) and (depths,)
        nm; m, inside the medium.
    incidence : float or "diffuse"
        Degrees, or isotropic light.
    max_stderr : float
        Determines the number of streams, and of paths through grains.
    limit_irradiance : bool
        Whether it applies to irradiances, too.
    threads : int
        For paths through grains.
    """
    edges = np.array([0.0, *depths, medium.depth_m])
    whole = make_granular_stack(medium, wavelengths, max_stderr, threads)
    parts, geometry = divide_medium(medium, whole, edges)
    cosine = None if incidence == "diffuse" else float(np.cos(np.radians(float(incidence))))
    with limit_blas_threads():
        solution = solve_profile(parts, geometry, cosine, max_stderr, limit_irradiance)
    variables = _make_variables(solution, edges)
    materials = list(medium.material_columns)
    coordinates = make_flux_coordinates(wavelengths, edges, materials)
    attributes = describe_solution(solution, max_stderr, limit_irradiance)
    return xr.Dataset(variables, coordinates, attributes)


def divide_medium(
    medium: Medium, whole: GranularStack, edges: np.ndarray
) -> tuple[GranularStack, LayerDivision]:
    """Return a medium and its snowpack divided at the edges of intervals (m)."""
    layers: Any = medium.scene_layers
    boundaries = np.cumsum([layer.depth_m for layer in layers])[:-1]
    begin = edges[:-1]
    # Rounding may put a depth at a boundary on either side of it.
    known = np.isclose(boundaries[:, np.newaxis], edges, rtol=ROUNDING_TOLERANCE, atol=0.0)
    for boundary, same in zip(boundaries, known, strict=True):
        begin = np.where(same[:-1], boundary, begin)
    starts = np.union1d(begin, boundaries)
    parts, owners = whole.divide(starts)
    fractions, attenuation = (
        np.array([getattr(layer, name) for layer in layers])
        for name in ("pore_fraction", "attenuation_per_m")
    )
    return parts, LayerDivision(fractions, attenuation, owners, np.searchsorted(starts, begin))


def describe_solution(
    solution: ProfileSolution, max_stderr: float, limit_irradiance: bool
) -> dict[str, Any]:
    """Return the attributes of a solution."""

    def reduce(errors: IntervalProfile) -> float:
        limited = [errors.upward[:1], errors.absorptance]
        limited += [errors.downward, errors.upward] if limit_irradiance else []
        return float(max(one.max() for one in limited))

    reached = reduce(solution.compute_error())
    return {
        "solver": DISCRETE_ORDINATES,
        "max_stderr_reached": reached,
        "stop_reason": "converged" if reached <= max_stderr else "solver_error",
        "rays": 0,
        "streams": solution.n_streams,
        "truncation_error": reduce(solution.truncation),
        "optics_error": reduce(solution.optics_error),
    }


def _make_variables(solution: ProfileSolution, edges: np.ndarray) -> dict[str, Variable]:
    profile, error = solution.profile, solution.compute_error()
    variables: dict[str, Variable] = {}
    for (name, (dim, label)), values, stderr in zip(
        QUANTITIES.items(), profile[:3], error[:3], strict=True
    ):
        dims = ("wavelength", dim)
        variables |= make_variable(name, dims, values.T, stderr.T, label)
        none = np.zeros((N_BATCHES, *values.T.shape))
        variables |= make_deviation_variable(name, dims, none, label)
    thickness = np.diff(edges)
    path, path_error = (one.path_length.T / thickness for one in (profile, error))
    parts, parts_error = (np.moveaxis(one.by_material, -1, 0) for one in (profile, error))
    intervals = ("wavelength", "interval")
    variables |= make_variable("actinic_flux", intervals, path, path_error, ACTINIC_LABEL)
    variables |= make_variable(
        "absorptance_of_material", (*intervals, "material"), parts, parts_error, MATERIAL_LABEL
    )
    return variables
