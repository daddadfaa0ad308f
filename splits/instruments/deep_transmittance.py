"""Transmittance of optically thick samples to a relative error, by splitting and roulette."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.keywords import reject_unknown_arguments
from splits.core.progress import Progress, ProgressCallback, with_progress
from splits.core.uncertainty import make_variable
from splits.core.validation import check_integer, check_range, invalid
from splits.instruments.single_scattering import single_scattering
from splits.kernels.grains.scene import Optics, Scene, make_bounding_optics
from splits.kernels.transport.splitting import trace_batch_with_splitting
from splits.media.medium import GranularMedium
from splits.simulation import random_streams
from splits.simulation.arguments import (
    check_incidence,
    check_medium,
    check_threads,
    check_wavelengths,
)
from splits.simulation.attributes import make_run_attributes, make_wavelength_coordinate
from splits.simulation.scene import build_scene, compute_optical_constants, get_reflecting_ground
from splits.simulation.threads import DaemonThreadPool

HISTORIES_PER_CHUNK = 64
"""Histories per chunk, the unit of parallel work."""
PILOT_HISTORIES = 512
"""Histories of each pilot run and of the first round."""
MAX_HISTORY_FRACTION = 0.05
"""Largest fraction of the sum from a single history for convergence: the error would be
underestimated if rare large contributions dominate it that were mostly not sampled yet."""
N_PILOTS = 3
"""Pilot runs, each of which samples deeper than the one before."""
N_DEPTH_SLICES = 24
"""Depth slices in which pilot runs record the decrease of the light."""
_MIN_SLICE_COLLISIONS = 200
"""Smallest number of collisions in a slice for the fit."""
_RATE_SAFETY_FACTOR = 0.6
"""Fraction of the diffusion-theory rate for the first pilot run: too high a rate splits
excessively."""
OPTICS_RAYS = 20_000


@reject_unknown_arguments
@with_progress
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
        True shows a progress bar; a function is called after every round with a `Progress` of
        relative errors.

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
    seed = check_integer("seed", seed, 0)
    max_rays = check_integer("max_rays", max_rays, 1)
    threads = check_threads(threads)
    ground = get_reflecting_ground(medium)
    if ground is not None:
        raise invalid("ground", ground.name, "open", "no light leaves through a ground")
    start_time = time.perf_counter()
    scene = build_scene(medium, incidence, False)
    index, absorption = compute_optical_constants(medium, wavelengths)
    initial_rates = estimate_attenuation_rate(medium, wavelengths, seed, threads)
    results = np.zeros((5, len(wavelengths)))
    stopping_rule = _DeepStoppingRule(relative_stderr, max_rays, start_time, progress)
    with DaemonThreadPool(threads) as pool:
        for row, initial_rate in enumerate(initial_rates):
            optics = make_bounding_optics(index[row], absorption[row : row + 1])
            tracer = _HistoryTracer(pool, seed, scene, optics)
            first_stream = random_streams.DEEP_TRANSMITTANCE + (N_PILOTS + 1) * row
            rate = _run_pilots(tracer, first_stream, initial_rate, float(medium.depth_m))
            tally = _trace_to_error(stopping_rule, tracer, first_stream + N_PILOTS, rate)
            results[:, row] = *tally.estimate(), tally.n_histories, rate
    transmittance, errors, fractions, n_rays, rates = results
    illumination = "hemispherical" if incidence == "diffuse" else "directional"
    long_name = f"{illumination}-hemispherical transmittance"
    dim, fraction_label = "wavelength", "largest fraction of the sum from one history"
    variables = {
        **make_variable("transmittance", dim, transmittance, errors, long_name),
        **make_variable("largest_history_fraction", dim, fractions, None, fraction_label),
        **make_variable(
            "attenuation_rate", dim, rates, None, "rate of splitting with depth", "m-1"
        ),
        **make_variable("rays", dim, n_rays.astype(np.int64), None, "rays"),
    }
    converged = (errors <= relative_stderr * transmittance) & (fractions <= MAX_HISTORY_FRACTION)
    attributes = {
        **make_run_attributes("Deep transmittance", "deep_transmittance", medium, start_time, seed),
        "incidence_deg": incidence,
        "relative_stderr": relative_stderr,
        "stop_reason": "converged" if converged.all() else "max_rays",
        "max_rays": max_rays,
    }
    coordinates = {"wavelength": make_wavelength_coordinate(wavelengths)}
    return xr.Dataset(variables, coordinates, attributes)


class _DeepStoppingRule(NamedTuple):
    """Stopping rule of a run, its start time and its progress callback."""

    relative_stderr: float
    max_rays: int
    start_time: float
    progress: ProgressCallback


def _trace_to_error(
    stopping_rule: _DeepStoppingRule, tracer: _HistoryTracer, stream: int, splitting_rate: float
) -> _TransmittanceTally:
    """Return the tally of one wavelength, traced to the requested error or number of rays."""
    tally = _TransmittanceTally()
    n_histories = PILOT_HISTORIES
    while True:
        tally.trace_histories(tracer, stream, n_histories, splitting_rate)
        mean, stderr, fraction = tally.estimate()
        error = stderr / mean if mean > 0.0 else np.inf
        if callable(stopping_rule.progress):
            seconds = time.perf_counter() - stopping_rule.start_time
            seconds_left = seconds * max((error / stopping_rule.relative_stderr) ** 2 - 1.0, 0.0)
            stopping_rule.progress(
                Progress(
                    tally.n_histories, error, stopping_rule.relative_stderr, seconds, seconds_left
                )
            )
        converged = error <= stopping_rule.relative_stderr and fraction <= MAX_HISTORY_FRACTION
        if converged or tally.n_histories >= stopping_rule.max_rays:
            return tally
        predicted = 1.1 * tally.n_histories * (error / stopping_rule.relative_stderr) ** 2
        n_histories = int(
            min(
                max(predicted, 1.5 * tally.n_histories),
                4.0 * tally.n_histories,
                2.0 * stopping_rule.max_rays,
            )
        )


class _HistoryTracer(NamedTuple):
    """Tracer of histories of one wavelength."""

    pool: DaemonThreadPool
    seed: int
    scene: Scene
    optics: Optics

    def trace(
        self, stream: int, first_history: int, splitting_rate: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return moments and depth profile of a chunk.

        See `splits.kernels.transport.splitting.trace_batch_with_splitting`.
        """
        moments, profile = np.zeros((2, 3)), np.zeros((2, N_DEPTH_SLICES))
        work = np.array([stream, first_history, HISTORIES_PER_CHUNK])
        result = trace_batch_with_splitting(
            self.seed, work, self.scene, self.optics, splitting_rate, moments, profile
        )
        if result.lost:
            raise RuntimeError("no grain fits between the boundaries along a ray")
        return moments[1], profile


class _TransmittanceTally:
    """Sums over histories in a fixed order.

    Attributes
    ----------
    n_histories : int
    """

    def __init__(self) -> None:
        self.n_histories = 0
        self._sum, self._sum_of_squares, self._max_score = 0.0, 0.0, 0.0
        self._depth_profile = np.zeros((2, N_DEPTH_SLICES))

    def trace_histories(
        self, tracer: _HistoryTracer, stream: int, n_histories: int, splitting_rate: float
    ) -> None:
        """Trace whole chunks up to a number of histories."""
        first_histories = range(self.n_histories, n_histories, HISTORIES_PER_CHUNK)
        for moments, profile in tracer.pool.map(
            lambda first: tracer.trace(stream, first, splitting_rate), first_histories
        ):
            self._sum += moments[0]
            self._sum_of_squares += moments[1]
            self._max_score = max(self._max_score, moments[2])
            self._depth_profile += profile
            self.n_histories += HISTORIES_PER_CHUNK

    def estimate(self) -> tuple[float, float, float]:
        """Return the mean, its standard error, and the largest fraction from one history."""
        mean = self._sum / self.n_histories
        stderr = np.sqrt(
            max(self._sum_of_squares / self.n_histories - mean**2, 0.0) / self.n_histories
        )
        fraction = self._max_score / self._sum if self._sum > 0.0 else 1.0
        return float(mean), float(stderr), float(fraction)

    def estimate_attenuation_rate(self, depth: float, fallback: float) -> float:
        """Return the rate (1/m) at which the weight decreases with depth, from sampled slices."""
        count, weight = self._depth_profile
        # Without the slices at the top and bottom, where light escapes.
        inside = (count >= _MIN_SLICE_COLLISIONS) & (weight > 0.0)
        inside[[0, -1]] = False
        if inside.sum() < 3:
            return fallback
        depths = depth * (np.arange(N_DEPTH_SLICES)[inside] + 0.5) / N_DEPTH_SLICES
        return max(-float(np.polyfit(depths, np.log(weight[inside]), 1)[0]), 0.0)


def _run_pilots(
    tracer: _HistoryTracer, first_stream: int, initial_rate: float, depth: float
) -> float:
    """Return the splitting rate (1/m) from pilot runs."""
    rate = _RATE_SAFETY_FACTOR * initial_rate
    for stage in range(N_PILOTS):
        pilot = _TransmittanceTally()
        pilot.trace_histories(tracer, first_stream + stage, PILOT_HISTORIES, rate)
        rate = min(pilot.estimate_attenuation_rate(depth, rate), initial_rate)
    return rate


def estimate_attenuation_rate(
    medium: GranularMedium, wavelengths: np.ndarray, seed: int, threads: int | None
) -> np.ndarray:
    """Return the rate (1/m) at which diffuse light decreases with depth, by diffusion theory.

    √(3 (1 − ω)(1 − ωg)) times the extinction (Ishimaru 1978, Wave Propagation and Scattering in
    Random Media, section 9.1), from the medium's single-scattering properties.
    """
    optics = single_scattering(medium, wavelengths, 1, OPTICS_RAYS, seed, threads)
    albedo = optics.single_scattering_albedo.values
    asymmetry = optics.asymmetry_parameter.values
    loss = np.clip(3.0 * (1.0 - albedo) * (1.0 - albedo * asymmetry), 0.0, 3.0)
    return optics.extinction.values * np.sqrt(loss)
