"""Transmittance of optically thick samples to a relative error, by splitting and roulette."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from splits.core.keywords import reject_unknown_arguments
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import make_variable
from splits.core.validation import check_integer, check_range, invalid
from splits.instruments.single_scattering import single_scattering
from splits.instruments.transmittance_tally import (
    N_PILOTS,
    PILOT_HISTORIES,
    TransmittanceTally,
)
from splits.media.checks import check_medium
from splits.media.medium import GranularMedium
from splits.simulation.arguments import check_incidence, check_wavelengths
from splits.simulation.engine import simulate
from splits.simulation.run_options import RunOptions, make_wavelength_coordinate
from splits.simulation.scene import build_scene, compute_optical_constants
from splits.simulation.stopping_rule import StoppingRule

_RATE_SAFETY_FACTOR = 0.6
"""Fraction of the diffusion-theory rate for the first pilot run: too high a rate splits
excessively."""
OPTICS_RAYS = 20_000


@reject_unknown_arguments
def deep_transmittance(
    medium: GranularMedium,
    wavelength_nm: Any,
    incidence_deg: float | str = 0.0,
    relative_stderr: float = 0.05,
    seed: int = 1,
    *,
    max_rays: int = 10_000_000,
    threads: int | None = None,
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the hemispherical transmittance to a relative error, also if it is very small.

    Each wavelength is traced separately in double precision.  Rays are split with increasing depth,
    and terminated by Russian roulette where their contribution is small (see
    `splits.kernels.transport.splitting`).  The splitting rate is determined by three pilot runs,
    whose rays are not scored, and does not bias the mean.

    Parameters
    ----------
    medium : GranularMedium
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    incidence_deg : float or "diffuse"
        Incidence angle of a beam, 0 to 89.9999 degrees, or isotropic radiance.
    relative_stderr : float
        Largest standard error relative to the transmittance, 0.001 to 0.5.
    seed : int
        Non-negative; results with the same seed are identical on any number of threads.
    max_rays : int
        Number of rays per wavelength, before splitting, after which a run stops.
    threads : int, optional
        Default: every CPU that this process may use.
    progress : callable or bool, optional
        True shows a progress bar; a function is called periodically with a `Progress` of relative
        errors.

    Returns
    -------
    xarray.Dataset
        Over ``wavelength``: ``transmittance`` and ``transmittance_stderr``;
        ``largest_history_fraction``, the largest fraction of the sum from one history;
        ``attenuation_rate`` (1/m), the rate of splitting with depth; ``rays``.  Attribute
        ``stop_reason`` is "converged" or "max_rays".

    Raises
    ------
    ValueError
        For a value outside its range.
    RuntimeError
        If no grain fits between the boundaries along a ray.
    """
    check_medium(medium, GranularMedium)
    wavelengths = check_wavelengths(wavelength_nm)
    incidence = check_incidence(incidence_deg)
    relative_stderr = check_range("relative_stderr", relative_stderr, 0.001, 0.5)
    run = RunOptions.from_arguments(seed, threads, progress=progress)
    max_rays = check_integer("max_rays", max_rays, 1)
    ground = medium.reflecting_ground
    if ground is not None:
        raise invalid("ground", ground.name, "open", "no light leaves through a ground")
    scene = build_scene(medium, incidence, False)
    constants = compute_optical_constants(medium, wavelengths)
    diffusion_rates = estimate_attenuation_rate(medium, wavelengths, run)
    rates = _RATE_SAFETY_FACTOR * diffusion_rates
    n_wavelengths = len(wavelengths)
    for stage in range(N_PILOTS):
        pilot = TransmittanceTally(constants, rates, stage)
        pilot_stop = StoppingRule(0.0, PILOT_HISTORIES * n_wavelengths, fixed=True)
        simulate(scene, pilot, pilot_stop, run._replace(progress=None))
        rates = np.minimum(pilot.fit_attenuation_rates(float(medium.depth_m)), diffusion_rates)
    tally = TransmittanceTally(constants, rates, N_PILOTS)
    stop = StoppingRule(relative_stderr, max_rays * n_wavelengths)
    evaluation = simulate(scene, tally, stop, run)
    transmittance, errors, fractions = evaluation.estimate
    illumination = "hemispherical" if incidence == "diffuse" else "directional"
    long_name = f"{illumination}-hemispherical transmittance"
    dim, fraction_label = "wavelength", "largest fraction of the sum from one history"
    variables = {
        **make_variable("transmittance", dim, transmittance, errors, long_name),
        **make_variable("largest_history_fraction", dim, fractions, None, fraction_label),
        **make_variable(
            "attenuation_rate", dim, rates, None, "rate of splitting with depth", "m-1"
        ),
        **make_variable("rays", dim, tally.stratum_rays, None, "rays"),
    }
    attributes = {
        **run.make_attributes("Deep transmittance", "deep_transmittance", medium),
        "incidence_deg": incidence,
        "relative_stderr": relative_stderr,
        "stop_reason": evaluation.stop_reason,
        "max_rays": max_rays,
    }
    coordinates = {"wavelength": make_wavelength_coordinate(wavelengths)}
    return xr.Dataset(variables, coordinates, attributes)


def estimate_attenuation_rate(
    medium: GranularMedium, wavelengths: np.ndarray, run: RunOptions
) -> np.ndarray:
    """Return the rate (1/m) at which diffuse light decreases with depth, by diffusion theory.

    √(3 (1 − ω)(1 − ωg)) times the extinction (Ishimaru 1978, Wave Propagation and Scattering in
    Random Media, section 9.1), from the medium's single-scattering properties.
    """
    optics = single_scattering(medium, wavelengths, 1, OPTICS_RAYS, run.seed, run.threads)
    albedo = optics.single_scattering_albedo.values
    asymmetry = optics.asymmetry_parameter.values
    loss = np.clip(3.0 * (1.0 - albedo) * (1.0 - albedo * asymmetry), 0.0, 3.0)
    return optics.extinction.values * np.sqrt(loss)
