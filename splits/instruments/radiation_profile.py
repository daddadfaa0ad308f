"""Irradiances inside a medium under a sky, and the power that it absorbs."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr

from splits.core.declarations import Quantity
from splits.core.inputs import (
    Kernel,
    MaxRays,
    Seed,
    Solver,
    StandardError,
    Threads,
    Wavelengths,
)
from splits.core.keywords import declare_function
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import Variable, make_variable
from splits.illumination.bands import Bands
from splits.illumination.sky import SkyInput
from splits.instruments.flux_tally import FluxTarget
from splits.instruments.irradiance_profile import (
    ProfileDepths,
    check_profile_depths,
    simulate_flux,
)
from splits.instruments.sky_mixing import (
    as_sky,
    choose_wavelengths,
    compute_band_error_weights,
    compute_band_weights,
    make_coverage_variable,
    make_sky_attributes,
    mix_direct_and_diffuse,
)
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.simulation.run_options import RunOptions

OUTPUT_VARIABLES = {
    "downward_irradiance": ("downward_irradiance", "depth", "downward irradiance"),
    "upward_irradiance": ("upward_irradiance", "depth", "upward irradiance"),
    "absorptance": ("absorbed_power", "interval", "absorbed power of the interval"),
}
"""Variables of an irradiance profile; names, dimensions and labels of those under a sky."""
PowerTarget = Annotated[
    Literal["absorbed_power", "irradiance"],
    Quantity("quantity to which the target error applies; irradiance means all of them"),
]
TotalIrradiance = Annotated[
    float | None,
    Quantity("incident irradiance at all wavelengths of the sky", "W m-2", low=0.0, open_low=True),
]


@declare_function
def radiation_profile(
    medium: Medium,
    sky: SkyInput,
    wavelength_nm: Wavelengths | None = None,
    *,
    depth_m: ProfileDepths,
    max_stderr: StandardError = 0.005,
    solver: Solver = "auto",
    target: PowerTarget = "absorbed_power",
    total_w_m2: TotalIrradiance = None,
    bands: Bands = None,
    seed: Seed = 1,
    max_rays: MaxRays = 20_000_000,
    threads: Threads = None,
    kernel: Kernel = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the irradiances inside a medium under a sky, and the power that it absorbs.

    Parameters
    ----------
    medium : Medium
        For example `splits.Snow` or `splits.Stack`; see `splits.irradiance_profile`.
    sky : Sky, str or mapping
        See `splits.sky`.
    wavelength_nm : array_like, optional
        Strictly increasing vacuum wavelengths (nm), at least two; by default every 10 nm from the
        first of the sky to 2495.  Other light is ignored, see ``irradiance_covered``.
    depth_m : array_like
        Strictly increasing depths (m) inside the medium; its top and, if it is finite, its bottom
        are added.  Include the boundaries between the layers of a stack to obtain the power that
        each layer absorbs.
    max_stderr : float
        Largest standard error in any band, relative to the band's incident irradiance; see
        `target`.
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
        As for `splits.irradiance_profile`.
    target : {"absorbed_power", "irradiance"}
        Quantities to which `max_stderr` applies: absorbed power and the light reflected at the
        top, or also irradiances at all depths.  In thick, weakly absorbing media the latter need
        many times as many rays, since light crosses each plane many times.
    total_w_m2 : float, optional
        Incident irradiance at all wavelengths of the sky (W m⁻²), to which it is scaled; the
        skies of SNICAR require it.
    bands : mapping or str, optional
        As for `splits.albedo`: ``{"photosynthetic": (400, 700)}``.
    seed : int
        Non-negative; diffuse light uses the next one.
    max_rays : int
        Number of rays after which the simulation of sunlight, and of diffuse light, stops.
    threads : int, optional
        Default: every CPU that this process may use.
    kernel : {"auto", "vectorized", "scalar"}
        As for `splits.irradiance_profile`.
    progress : callable or bool, optional
        True shows a progress bar; a function is called periodically with a `Progress`.

    Returns
    -------
    xarray.Dataset
        Over ``band``, the first of which is "broadband", and ``depth``: ``downward_irradiance`` and
        ``upward_irradiance`` (W m⁻²).  Over ``band`` and ``interval``, between successive depths:
        ``absorbed_power`` (W m⁻²).  All with standard errors ``…_stderr``, which include the error
        of interpolation between the wavelengths.  Over ``band`` ``irradiance_covered``, the
        fraction of the band's light within the wavelengths.

    Raises
    ------
    ValueError
        For a value outside its range, or wavelengths outside the spectrum of the sky.

    Examples
    --------
    >>> import splits
    >>> snow = splits.Snow.natural(specific_surface_area_m2_kg=30, depth_m=0.1)
    >>> sky = splits.sky("midlatitude_winter")
    >>> ds = splits.radiation_profile(
    ...     snow, sky, [400, 700, 1000], depth_m=[0.02], max_stderr=0.05, total_w_m2=400
    ... )
    >>> ds.absorbed_power.dims
    ('band', 'interval')
    """
    check_medium(medium, allow_semi_infinite=True)
    sky_spectrum = as_sky(sky).scale_to(total_w_m2)
    wavelengths = choose_wavelengths(wavelength_nm, sky_spectrum, 2)
    run = RunOptions.start(seed, threads, kernel, progress)
    depths = check_profile_depths(depth_m, medium)
    named = sky_spectrum.make_bands(bands)
    sky_spectrum.check_bands(named, wavelengths)
    weights, band_irradiance = compute_band_weights(sky_spectrum, named, wavelengths)
    direct_fraction = sky_spectrum.compute_direct_fraction(wavelengths)
    targets = make_sky_targets(direct_fraction, weights, target == "irradiance")

    def simulate_component(incidence: float | str, number: int) -> xr.Dataset:
        component_run = run._replace(seed=run.seed + number)
        return simulate_flux(
            medium, wavelengths, depths, incidence, max_stderr, max_rays, targets[number],
            component_run, solver,
        )  # fmt: skip

    dataset = mix_direct_and_diffuse(
        sky_spectrum, wavelengths, simulate_component, list(OUTPUT_VARIABLES)
    )
    error_weights = weights.sum(axis=1, keepdims=True) * compute_band_error_weights(
        sky_spectrum, named, wavelengths
    )
    axes = {"wavelength": wavelengths}
    band_weights = xr.DataArray(weights, axes, ("band", "wavelength"))
    between = xr.DataArray(error_weights, axes, ("estimate", "band", "wavelength"))
    variables: dict[str, Variable] = {}
    for name, (label, dim, long_name) in OUTPUT_VARIABLES.items():
        mean = (band_weights * dataset[name]).sum("wavelength")
        # Band by band, which limits the memory for many depths.
        errors = [dataset.errors.weighted_sum(name, one)[1] for one in band_weights]
        squares = (xr.dot(between, dataset[name], dim="wavelength") ** 2).sum("estimate")
        error = (xr.concat(errors, "band") ** 2 + squares) ** 0.5
        values, stderr = (one.transpose("band", dim).values for one in (mean, error))
        variables |= make_variable(label, ("band", dim), values, stderr, long_name, "W m-2")
    variables |= make_coverage_variable(weights, band_irradiance)
    attributes = {
        **run.make_attributes("Sunlight inside", "radiation_profile", medium),
        **make_sky_attributes(sky_spectrum, named),
        "irradiance_w_m2": band_irradiance[0],
        "max_stderr": max_stderr,
        "target": target,
        "max_rays": max_rays,
        **dataset.attrs,
    }
    coordinates: dict[str, Any] = {
        name: dataset[name] for name in ("depth", "interval_top", "interval_bottom")
    }
    return xr.Dataset(variables, {**coordinates, "band": list(named)}, attributes)


def make_sky_targets(
    direct_fraction: np.ndarray, band_weights: np.ndarray, limit_irradiance: bool
) -> list[FluxTarget]:
    """Return the targets for sunlight and for diffuse light.

    Each may contribute to a band's variance in proportion to its fraction of the band's light.

    Parameters
    ----------
    direct_fraction : float, shape (wavelengths,)
        Fraction of direct sunlight.
    band_weights : float, shape (bands, wavelengths)
        Irradiance of each band by wavelength.
    limit_irradiance : bool
        Whether errors of irradiances are limited, too.
    """
    normalized = band_weights / band_weights.sum(axis=1, keepdims=True)
    targets = []
    for fraction in (direct_fraction, 1.0 - direct_fraction):
        band_fraction = (normalized * fraction).sum(axis=1)
        variance_fraction = np.where(band_fraction > 0.0, band_fraction, 1.0)
        targets.append(FluxTarget(limit_irradiance, normalized * fraction, variance_fraction))
    return targets
