"""Single-scattering properties of granular media, for other radiative-transfer models."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
import xarray as xr

from splits.core.declarations import Quantity
from splits.core.inputs import Seed, Threads, Wavelengths
from splits.core.keywords import declare_function
from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import invalid
from splits.media.kinds import check_medium
from splits.media.medium import GranularMedium
from splits.media.particle_layer import ANGLE, ELEMENTS
from splits.simulation.grain_optics import (
    GRAIN_RAYS_PER_CHUNK,
    INTERPOLATION_TOLERANCE,
    GrainOpticsRequest,
    compute_grain_matrix,
    compute_grain_optics,
)
from splits.simulation.run_options import RunOptions, make_wavelength_coordinate
from splits.simulation.scene import IncidentPolarization, build_scene, compute_material_constants
from splits.simulation.spectral_nodes import choose_nodes

VARIABLE_LABELS = {
    "single_scattering_albedo": ("single-scattering albedo", "1"),
    "asymmetry_parameter": ("asymmetry parameter", "1"),
    "legendre_moment": ("Legendre moment of the phase function", "1"),
    "displacement_along_incident": ("mean displacement in a grain along the incident ray", "m"),
    "displacement_along_exit": ("mean displacement in a grain along the scattered ray", "m"),
    "mean_square_displacement": ("mean square displacement in a grain", "m2"),
    "wet_fraction": ("fraction of the scattered light that enters a wet pore", "1"),
    "extinction": ("extinction coefficient", "m-1"),
    "optical_thickness": ("optical thickness of extinction", "1"),
}
MATRIX_ANGLES_DEG = np.linspace(0.0, 180.0, 181)
"""Scattering angles of the scattering matrix (degrees)."""
ERROR_COMPONENTS = {
    "_jackknife": (("batch",), "without one batch of the rays:"),
    "_interpolation_error_bound": ((), "bound on the interpolation error of"),
}
"""Components of the errors, for theories: suffixes of names, additional dimensions, and labels."""


MomentOrder = Annotated[int, Quantity("highest order of the Legendre moments", low=1, high=4096)]
GrainRays = Annotated[int, Quantity("rays per refractive-index node, rounded up", low=2)]
WetPores = Annotated[
    Literal["saturation", "equilibrium"],
    Quantity("fraction of the light between grains that is in wet pores"),
]
TracesStokes = Annotated[bool, Quantity("whether polarization is traced")]


@declare_function
def single_scattering(
    medium: GranularMedium,
    wavelength_nm: Wavelengths,
    *,
    moments: MomentOrder = 64,
    rays: GrainRays = 200_000,
    wet_pores: WetPores = "saturation",
    stokes: TracesStokes = False,
    seed: Seed = 1,
    threads: Threads = None,
) -> xr.Dataset:
    """Simulate the single-scattering properties of the grains of a medium.

    Each ray hits one grain.  The pore space around the grain is wet with the probability
    `wet_fraction` of the medium.  Grains are sampled and traced by the rules of the full model
    (SPLITS sections 4.3.3-4.3.4, SPLITSnow 3.2-3.3) without the rules for overlapping grains.

    As in the model of the papers, diffraction is excluded: the extinction is that of the geometric
    cross-section, half of that of Mie theory for large grains, and the phase function lacks the
    narrow forward peak.  `splits.with_diffraction` adds both.

    Parameters
    ----------
    medium : GranularMedium
        For example `splits.Snow`.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    moments : int
        Highest order l of the Legendre moments, 1 to 4096.
    rays : int
        Rays per refractive-index node, at least 2; rounded up to whole chunks of
        `splits.simulation.grain_optics.GRAIN_RAYS_PER_CHUNK`.
    wet_pores : {"saturation", "equilibrium"}
        Fraction of the light between grains that is in wet pores.  "saturation" is the
        `wet_fraction` S, which is correct where light enters the sample.  "equilibrium" is
        S n²/(S n² + 1 − S), with the index n of water relative to air, which is correct deep in
        the sample, where radiance is proportional to n².
    stokes : bool
        Whether polarization is traced, as for `splits.spectrophotometer`, which changes the
        asymmetry parameter of smooth spheres by 0.003; and whether the scattering matrix is
        computed as well, from further rays.
    seed : int
        Non-negative; results with the same seed are identical on any number of threads.
    threads : int, optional
        Default: every CPU that this process may use.

    Returns
    -------
    xarray.Dataset
        Over ``wavelength``, all except ``extinction`` and ``optical_thickness``, which are exact,
        with standard error ``…_stderr``: ``single_scattering_albedo`` (0 to 1, absorption by the
        pores included), ``asymmetry_parameter``, ``legendre_moment`` over (wavelength, order), χ_l
        = <P_l(cosΘ)> weighted by the light that leaves the grain, χ_0 = 1; ``extinction`` (1/m),
        the collisions with grains per metre plus absorption by the pores, and
        ``optical_thickness``, which is left out for a medium of infinite depth.

        For `splits.analysis.theory.spectra.correct_dense_packing`:
        ``displacement_along_incident`` and ``displacement_along_exit`` (m), the displacement from
        entry to exit along the direction before and after; ``mean_square_displacement`` (m²); and
        ``wet_fraction``, the fraction of the scattered light that enters a wet pore.

        For the correlations of errors: ``…_jackknife`` over ``batch`` is each quantity without
        one of `splits.kernels.grains.single_grain.N_SCATTERING_BATCHES` equal batches of the rays,
        and ``…_interpolation_error_bound`` is a bound on its error from interpolation between
        refractive indices.

        With `stokes`, the elements of the scattering matrix over ``angle_deg`` (degrees), the
        scattering angle: ``P11``, ``P12``, ``P33``, ``P34``, ``P22`` and ``P44``, of the Stokes
        vector with the scattering plane as reference; the mean of ``P11`` over all directions is 1.
        Elements are means weighted by the linear functions of the cosine between two angles.  The
        dataset at one wavelength is a `scattering_matrix` of `splits.ParticleLayer`.

    Raises
    ------
    ValueError
        For a value outside its range.

    Notes
    -----
    Paths are traced with the refractive indices of a few nodes, as by the spectral estimator;
    standard errors include the bound on the interpolation error.
    """
    check_medium(medium, GranularMedium, allow_semi_infinite=True)
    if medium.pores:
        raise invalid("pores", dict(medium.pores), "empty: pores are dry or wet here")
    wavelengths = np.asarray(wavelength_nm)
    rays = GRAIN_RAYS_PER_CHUNK * -(-rays // GRAIN_RAYS_PER_CHUNK)
    run = RunOptions.start(seed, threads)
    # Polarization changes how much light successive interfaces reflect, and so all other means.
    scene = build_scene(medium, 0.0, False, IncidentPolarization() if stokes else None)
    request = GrainOpticsRequest(moments, rays, wet_pores, run)
    constants = compute_material_constants(medium, wavelengths)
    nodes = choose_nodes(constants.indices, medium.list_interfaces(), INTERPOLATION_TOLERANCE)
    values = compute_grain_optics(medium, scene, constants, request, nodes)
    if not medium.is_semi_infinite:
        values["optical_thickness"] = values["extinction"] * medium.depth_m
    attributes = {
        **run.make_attributes("Single-scattering properties", "single_scattering", medium),
        "diffraction": "none",
        "extinction_by_grains_per_m": float(medium.extinction_per_m),
        "interpolation_error_bound": float(nodes.interpolation_bound.max()),
        "wet_pores": wet_pores,
        "rays": rays * len(nodes.index),
        "ensembles": len(nodes.index),
    }
    variables: dict[str, Variable] = {}
    for name, (long_name, units) in VARIABLE_LABELS.items():
        if name not in values:
            continue
        dims = ("wavelength", "order")[: values[name].ndim]
        stderr = values.get(f"{name}_stderr")
        variables |= make_variable(name, dims, values[name], stderr, long_name, units)
        if stderr is not None:
            for suffix, (extra_dims, prefix) in ERROR_COMPONENTS.items():
                all_dims, label = (*extra_dims, *dims), f"{prefix} {long_name}"
                variables |= make_variable(
                    f"{name}{suffix}", all_dims, values[name + suffix], None, label, units
                )
    coordinates = {
        "wavelength": make_wavelength_coordinate(wavelengths),
        "order": (
            "order", np.arange(moments + 1),
            {"long_name": "order of the Legendre moment", "units": "1"},
        ),
    }  # fmt: skip
    dataset = xr.Dataset(variables, coordinates, attributes)
    if not stokes:
        return dataset
    elements, stderrs = compute_grain_matrix(medium, constants, request, nodes, MATRIX_ANGLES_DEG)
    matrix: dict[str, Variable] = {}
    for name, element, stderr in zip(ELEMENTS, elements, stderrs, strict=True):
        label = f"element {name} of the scattering matrix"
        matrix |= make_variable(name, ("wavelength", ANGLE), element, stderr, label)
    angle = (ANGLE, MATRIX_ANGLES_DEG, {"long_name": "scattering angle", "units": "degree"})
    return dataset.assign(matrix).assign_coords({ANGLE: angle})
