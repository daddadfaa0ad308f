"""Vertical profiles of irradiance, and the absorptance between depths."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
import xarray as xr

from splits.core.declarations import Quantity
from splits.core.inputs import (
    Incidence,
    Kernel,
    MaxRays,
    Seed,
    Solver,
    StandardError,
    Threads,
    Wavelengths,
)
from splits.core.keywords import instrument
from splits.core.progress import ProgressCallback
from splits.instruments.flux_tally import FluxTarget
from splits.instruments.profiles import (
    FluxRequest,
    ProfileDepths,
    check_profile_depths,
    simulate_flux,
)
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.simulation.run_options import RunOptions

ProfileTarget = Annotated[
    Literal["irradiance", "absorptance"],
    Quantity("quantity to which the target error applies; irradiance means all of them"),
]


@instrument
def irradiance_profile(
    medium: Medium,
    wavelength_nm: Wavelengths,
    incidence_deg: Incidence = 0.0,
    *,
    depth_m: ProfileDepths,
    max_stderr: StandardError = 0.005,
    solver: Solver = "auto",
    target: ProfileTarget = "irradiance",
    seed: Seed = 1,
    max_rays: MaxRays = 20_000_000,
    threads: Threads = None,
    kernel: Kernel = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the irradiances inside a medium, and the absorptance between depths.

    Parameters
    ----------
    medium : Medium
        For example `splits.Snow`, `splits.Stack` or `splits.ParticleLayer`; may be semi-infinite.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    incidence_deg : float or "diffuse"
        Incidence angle of a beam, 0 to 89.9999 degrees, or isotropic radiance.
    depth_m : array_like
        Strictly increasing depths (m) inside the medium, at most 200.  The top of the medium and,
        unless it is semi-infinite, its bottom are added.
    max_stderr : float
        Largest standard error, 1e-6 to 0.5; see `target`.
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
        As for `splits.spectrophotometer`.  Discrete ordinates need point grains of one material
        that absorbs.
    target : {"irradiance", "absorptance"}
        Quantities to which `max_stderr` applies: all irradiances and absorptances, or only
        absorptances and reflectance, which need far fewer rays in thick, weakly absorbing media.
    seed : int
        Non-negative; results with the same seed are identical on any number of threads.
    max_rays, threads, kernel, progress
        As for `splits.spectrophotometer`.

    Returns
    -------
    xarray.Dataset
        Over ``wavelength`` and ``depth``, relative to the incident irradiance:
        ``downward_irradiance`` and ``upward_irradiance``.  At the top, the latter is the
        reflectance.  Over ``wavelength`` and ``interval``, between successive depths:
        ``absorptance``, the fraction of the incident light that is absorbed there;
        ``absorptance_of_material``, the same by ``material``; and ``actinic_flux``, the mean path
        length of light in the interval, in grains and pores, divided by its thickness.  All with
        standard errors ``…_stderr``; irradiances and absorptances also with ``…_batches``, see
        `splits.core.uncertainty`.  Reflectance, absorptances, and the net irradiance at the bottom
        add up to 1.  The last interval of a semi-infinite medium extends below all depths; its mean
        actinic flux is 0 if it absorbs.

    Raises
    ------
    ValueError
        For a value outside its range.

    Notes
    -----
    Absorption by the particles of a `splits.ParticleLayer` is treated as absorption along the path,
    which is equivalent.  It is attributed to the matrix of their layer.

    A ray through a grain that lies across a plane crosses the plane where it leaves the grain on
    the other side.  The absorptance of this grain belongs to the interval in which the ray enters
    it.  At a boundary between layers of different saturation, a plane records transmitted light;
    the light that the boundary reflects is included on neither side.

    The actinic flux is the absorptance times the path per absorbed light, which in particles and in
    dry layers of point grains is a property of the layer: actinic flux × thickness × absorption
    coefficient = absorptance, with both solvers.  Paths measure it in other media, where, as for
    the absorptance of each material, absorption is assumed to be evenly distributed along the path
    between planes.  Where single grains or pores absorb much of the light that crosses them, both
    are approximate; their errors include this (`splits.instruments.flux_media`).  The
    absorptance of an interval is not affected.  With discrete ordinates both follow exactly from
    the balance of light in each interval (`splits.discrete_ordinates.profiles`).

    References
    ----------
    Paths and weights are those of SPLITSnow Eqs 5-6; actinic flux as path per volume, for example
    Mayer (2009), EPJ Web of Conferences 1, 75, section 4.
    """
    check_medium(medium, allow_semi_infinite=True)
    request = FluxRequest(
        medium, np.asarray(wavelength_nm), check_profile_depths(depth_m, medium), incidence_deg,
        max_stderr, max_rays,
    )  # fmt: skip
    run = RunOptions.start(seed, threads, kernel, progress)
    return simulate_flux(request, FluxTarget(target == "irradiance"), run, solver)
