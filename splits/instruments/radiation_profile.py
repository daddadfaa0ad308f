"""Sunlight inside a sample: irradiances at depths, and the power absorbed between them."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.core.progress import ProgressCallback, with_progress
from splits.core.uncertainty import Variable, compute_weighted_error, make_variable
from splits.core.validation import check_choice, check_range, reject_unknown_arguments
from splits.illumination.sky import Sky
from splits.instruments.flux_stopping_rule import FluxStoppingRule
from splits.instruments.irradiance_profile import FluxRequest, simulate_flux
from splits.instruments.sky_mixing import (
    as_sky,
    choose_wavelengths,
    make_sky_attributes,
    mix_direct_and_diffuse,
)
from splits.media.medium import Medium
from splits.simulation.arguments import check_integer, check_threads
from splits.simulation.attributes import make_run_attributes

OUTPUT_VARIABLES = {
    "downward_irradiance": ("downward_irradiance", "downward irradiance"),
    "upward_irradiance": ("upward_irradiance", "upward irradiance"),
    "absorptance": ("absorbed_power", "absorbed power of the interval"),
}
"""Variables of a profile, and what becomes of them in sunlight."""
STOP_REASONS = ("converged", "interpolation_bound", "max_rays")
"""What ended a run: the error asked for was reached, or one of what kept it from that."""
POWER_ERROR_QUANTITIES = ("absorbed_power", "irradiance")
"""Quantities that a largest error is asked of: the last stands for all of them."""


@reject_unknown_arguments
@with_progress
def radiation_profile(
    medium: Medium,
    sky: Sky | str | Mapping[str, Any],
    depth_m: Any,
    wavelength_nm: Any = None,
    max_stderr: float = 0.005,
    seed: int = 1,
    *,
    target: str = "absorbed_power",
    total_w_m2: float | None = None,
    bands: Mapping[str, Any] | str | None = None,
    max_rays: int = 20_000_000,
    threads: int | None = None,
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Measure the light of a sky inside a medium, and the power that is absorbed there.

    Parameters
    ----------
    medium : GranularMedium, LayeredMedium or ParticleMedium
        For example `splits.Snow` or `splits.Stack`; see `splits.irradiance_profile`.
    sky : Sky, str or mapping
        See `splits.sky`.
    depth_m : array_like
        Strictly increasing depths (m) inside the medium; its top and, if it ends, its bottom are
        added.  Faces of a stack's layers among them give the power absorbed by each layer.
    wavelength_nm : array_like, optional
        Strictly increasing vacuum wavelengths (nm), at least two; by default every 10 nm from the
        first of the sky to 2495.  Light beyond them is left out, see ``irradiance_covered``.
    max_stderr : float
        Largest standard error wanted in any band, as a part of the band's irradiance from above;
        see `target`.
    seed : int
        Non-negative; diffuse light takes the next.
    target : {"absorbed_power", "irradiance"}
        Quantities whose errors `max_stderr` limits: absorbed power and the light sent back at the
        top, or irradiances at all depths besides.  In bright and thick packs the latter take
        many times as many rays, since light crosses a plane there many times.
    total_w_m2 : float, optional
        Irradiance from above at all wavelengths of the sky (W m⁻²), to which it is scaled; the
        skies of SNICAR need it.
    bands : mapping or str, optional
        As for `splits.albedo`: ``{"photosynthetic": (400, 700)}``.
    max_rays : int
        Rays after which the light of the sun, and diffuse light, is traced no further.
    threads : int, optional
        Default: every CPU this process may use.
    progress : callable or bool, optional
        True shows a bar; a function is called now and then with a `Progress`.

    Returns
    -------
    xarray.Dataset
        Over ``band``, the first of which is "broadband", and ``depth``: ``downward_irradiance`` and
        ``upward_irradiance`` (W m⁻²).  Over ``band`` and ``interval``, between successive depths:
        ``absorbed_power`` (W m⁻²).  All with standard errors ``…_stderr``.  Over ``band``
        ``irradiance_covered``, the part of the band's light within the wavelengths.

    Raises
    ------
    ValueError
        For a value outside its range, or wavelengths that the sky does not have.

    Examples
    --------
    >>> import splits
    >>> snow = splits.Snow.natural(specific_surface_area_m2_kg=30, depth_m=0.1)
    >>> sky = splits.sky("midlatitude_winter")
    >>> ds = splits.radiation_profile(snow, sky, [0.02], [400, 700, 1000], 0.05, total_w_m2=400)
    >>> ds.absorbed_power.dims
    ('band', 'interval')
    """
    begun = time.perf_counter()
    light = as_sky(sky).scale_to(total_w_m2)
    w = choose_wavelengths(wavelength_nm, light, 2)
    max_stderr = check_range("max_stderr", max_stderr, 1e-6, 0.5)
    check_choice("target", target, POWER_ERROR_QUANTITIES)
    seed, threads = check_integer("seed", seed, 0), check_threads(threads)
    max_rays = check_integer("max_rays", max_rays, 1)
    named = light.make_bands(bands)
    light.check_bands(named, w)
    weights = np.array([light.compute_weights(w, band) for band in named.values()])
    goals = _make_stopping_rules(
        light.compute_direct_fraction(w), weights, max_stderr, target == POWER_ERROR_QUANTITIES[1]
    )
    axes: dict[str, Any] = {}
    runs: list[dict[str, Any]] = []

    def run(incidence: float | str, number: int) -> xr.Dataset:
        given = (medium, w, depth_m, incidence, seed + number, max_rays, threads, "auto", progress)
        found = simulate_flux(FluxRequest(*given).validate(), goals[number])
        runs.append(found.attrs)
        axes.update({name: found[name] for name in ("depth", "interval_top", "interval_bottom")})
        return found

    found = mix_direct_and_diffuse(light, w, run, list(OUTPUT_VARIABLES))
    variables: dict[str, Variable] = {}
    each = xr.DataArray(weights, {"wavelength": w}, ("band", "wavelength"))
    for name, (label, long_name) in OUTPUT_VARIABLES.items():
        value = (each * found[name]).sum("wavelength")
        error = xr.concat([compute_weighted_error(found, name, one) for one in each], "band")
        place = next(dim for dim in value.dims if dim != "band")
        dims = ("band", str(place))
        variables |= make_variable(
            label, dims, value.transpose(*dims).values, error.transpose(*dims).values, long_name,
            "W m-2",
        )  # fmt: skip
    whole = [light.compute_weights(light.wavelength_nm, band).sum() for band in named.values()]
    about = {"long_name": "part of the band's light within the wavelengths", "units": "1"}
    variables["irradiance_covered"] = ("band", weights.sum(axis=1) / whole, about)
    facts = {
        **make_run_attributes("Sunlight inside", "radiation_profile", medium, begun, seed, threads),
        **make_sky_attributes(light),
        "irradiance_w_m2": whole[0],
        "max_stderr": max_stderr,
        "target": target,
        "stop_reason": max((r["stop_reason"] for r in runs), key=STOP_REASONS.index),
        "max_rays": max_rays,
        "rays": sum(r["rays"] for r in runs),
    }
    return xr.Dataset(variables, {**axes, "band": list(named)}, facts)


def _make_stopping_rules(
    direct_fraction: np.ndarray, band_weights: np.ndarray, max_stderr: float, limit_irradiance: bool
) -> list[FluxStoppingRule]:
    """Return what is asked of the light of the sun, and of diffuse light.

    Each may take that part of a band's variance which it has of the band's light.

    Parameters
    ----------
    direct_fraction : float, shape (wavelengths,)
        Part of the light that comes from the sun.
    band_weights : float, shape (bands, wavelengths)
        Irradiance of each band that a wavelength stands for.
    max_stderr : float
    limit_irradiance : bool
        Whether errors are asked of irradiances, too.
    """
    parts = band_weights / band_weights.sum(axis=1, keepdims=True)
    goals = []
    for part in (direct_fraction, 1.0 - direct_fraction):
        lit = (parts * part).sum(axis=1)
        share = np.where(lit > 0.0, lit, 1.0)
        goals.append(FluxStoppingRule(max_stderr, limit_irradiance, parts * part, share))
    return goals
