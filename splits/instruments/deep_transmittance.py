"""Transmittance of samples that let almost nothing through, to a relative error."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.progress import Progress, ProgressCallback, with_progress
from splits.core.uncertainty import make_variable
from splits.core.validation import check_range, invalid, reject_unknown_arguments
from splits.instruments.single_scattering import single_scattering
from splits.kernels.grains.scene import Optics, Scene, make_bounding_optics
from splits.kernels.grains.splitting import trace_batch_with_splitting
from splits.media.medium import GranularMedium
from splits.simulation import random_streams
from splits.simulation.arguments import (
    check_incidence,
    check_integer,
    check_medium,
    check_threads,
    check_wavelengths,
)
from splits.simulation.attributes import make_run_attributes, make_wavelength_coordinate
from splits.simulation.scene import build_scene, compute_optical_constants, get_reflecting_ground
from splits.simulation.threads import DaemonThreadPool

HISTORIES_PER_CHUNK = 64
"""Families per batch: the grain of parallel work."""
PILOT_HISTORIES = 512
"""Families of each pilot and of the first round."""
MAX_HISTORY_FRACTION = 0.05
"""A run goes on while a single family makes more than this of the sum: an error estimated from
rare large contributions that mostly have not been seen yet would be too small."""
N_PILOTS = 3
"""Pilots, each of which sees deeper than the one before."""
N_DEPTH_SLICES = 24
"""Slices of the depth in which pilots look how fast the light falls off."""
_MIN_SLICE_COLLISIONS = 200
"""Grains met in a slice from which on its weight counts."""
_RATE_SAFETY_FACTOR = 0.6
"""Part of diffusion theory's rate that the first pilot dares: too high a rate multiplies rays."""
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
    """Measure hemispherical transmittance to a relative error, however small it is.

    Each wavelength is traced by itself in double precision; rays are split as they get deeper and
    end by roulette where they cannot matter (see `splits.kernels.grains.splitting`).  How fast they
    are split comes from three pilots, whose rays do not count, and does not touch the mean.

    Parameters
    ----------
    medium : GranularMedium
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    incidence_deg : float or "diffuse"
        Polar angle of a beam, 0 to 89.9999 degrees, or equal radiance from everywhere.
    relative_stderr : float
        Largest standard error wanted as a part of the transmittance, 0.001 to 0.5.
    seed : int
        Non-negative; the same seed gives the same numbers bit for bit on any number of threads.
    max_rays : int
        Rays per wavelength, not counting those they are split into, after which a run stops.
    threads : int, optional
        Default: every CPU this process may use.
    progress : callable or bool, optional
        True shows a bar; a function is called after every round with a `Progress`, errors being
        relative.

    Returns
    -------
    xarray.Dataset
        ``transmittance`` and ``transmittance_stderr`` over ``wavelength``; ``largest_history_fraction``, what
        part of the sum the heaviest family of rays makes; ``estimate_attenuation_rate`` (1/m), the rate at
        which rays were split; ``rays``.  Attribute ``stop_reason`` is "converged" or "max_rays".

    Raises
    ------
    ValueError
        For a value outside its range.
    RuntimeError
        If a ray found no grain that fits where it was.
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
        raise invalid("ground", ground.name, "open", "what would reach a ground is the question")
    begun = time.perf_counter()
    scene = build_scene(medium, incidence, False)
    index, absorption = compute_optical_constants(medium, wavelengths)
    first_guess = estimate_attenuation_rate(medium, wavelengths, seed, threads)
    results = np.zeros((5, len(wavelengths)))
    goal = _DeepStoppingRule(relative_stderr, max_rays, begun, progress)
    with DaemonThreadPool(threads) as pool:
        for row, guess in enumerate(first_guess):
            optics = make_bounding_optics(index[row], absorption[row : row + 1])
            source = _HistoryTracer(pool, seed, scene, optics)
            number = random_streams.DEEP_TRANSMITTANCE + (N_PILOTS + 1) * row
            rate = _run_pilots(source, number, guess, float(medium.depth_m))
            run = _trace_to_error(goal, source, number + N_PILOTS, rate)
            results[:, row] = *run.estimate(), run.n_histories, rate
    transmittance, errors, shares, count, rates = results
    long_name = (
        "hemispherical" if incidence == "diffuse" else "directional"
    ) + "-hemispherical transmittance"
    over = "wavelength"
    variables = {
        **make_variable("transmittance", over, transmittance, errors, long_name),
        **make_variable(
            "largest_history_fraction", over, shares, None, "share of the heaviest family of rays"
        ),
        **make_variable(
            "attenuation_rate", over, rates, None, "rate at which rays are split with depth", "m-1"
        ),
        **make_variable("rays", over, count.astype(np.int64), None, "rays"),
    }
    reached = (errors <= relative_stderr * transmittance) & (shares <= MAX_HISTORY_FRACTION)
    facts = {
        **make_run_attributes("Deep transmittance", "deep_transmittance", medium, begun, seed),
        "incidence_deg": incidence,
        "relative_stderr": relative_stderr,
        "stop_reason": "converged" if reached.all() else "max_rays",
        "max_rays": max_rays,
    }
    return xr.Dataset(variables, {"wavelength": make_wavelength_coordinate(wavelengths)}, facts)


class _DeepStoppingRule(NamedTuple):
    """What is asked for, when that began, and who wants to know how far it is."""

    relative_stderr: float
    max_rays: int
    start_time: float
    progress: ProgressCallback


def _trace_to_error(
    stopping_rule: _DeepStoppingRule, tracer: _HistoryTracer, stream: int, splitting_rate: float
) -> _TransmittanceTally:
    """Return families of rays of one wavelength, traced until the error or the rays asked for."""
    run = _TransmittanceTally()
    wanted = PILOT_HISTORIES
    while True:
        run.trace_histories(tracer, stream, wanted, splitting_rate)
        mean, stderr, share = run.estimate()
        error = stderr / mean if mean > 0.0 else np.inf
        if callable(stopping_rule.progress):
            seconds = time.perf_counter() - stopping_rule.start_time
            left = seconds * max((error / stopping_rule.relative_stderr) ** 2 - 1.0, 0.0)
            stopping_rule.progress(
                Progress(run.n_histories, error, stopping_rule.relative_stderr, seconds, left)
            )
        done = error <= stopping_rule.relative_stderr and share <= MAX_HISTORY_FRACTION
        if done or run.n_histories >= stopping_rule.max_rays:
            return run
        needed = 1.1 * run.n_histories * (error / stopping_rule.relative_stderr) ** 2
        wanted = int(
            min(
                max(needed, 1.5 * run.n_histories),
                4.0 * run.n_histories,
                2.0 * stopping_rule.max_rays,
            )
        )


class _HistoryTracer(NamedTuple):
    """What traces families of rays of one wavelength."""

    pool: DaemonThreadPool
    seed: int
    scene: Scene
    optics: Optics

    def trace(
        self, stream: int, first_history: int, splitting_rate: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return moments and profile of a batch, see `splits.kernels.grains.splitting.trace_batch_with_splitting`."""
        moments, profile = np.zeros((2, 3)), np.zeros((2, N_DEPTH_SLICES))
        work = np.array([stream, first_history, HISTORIES_PER_CHUNK])
        spent = trace_batch_with_splitting(
            self.seed, work, self.scene, self.optics, splitting_rate, moments, profile
        )
        if spent.lost:
            raise RuntimeError("a ray found no grain that fits between the boundaries")
        return moments[1], profile


class _TransmittanceTally:
    """Families of rays added up in order.

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
        """Trace whole batches until there are so many rays."""
        batches = range(self.n_histories, n_histories, HISTORIES_PER_CHUNK)
        for moments, profile in tracer.pool.map(
            lambda first: tracer.trace(stream, first, splitting_rate), batches
        ):
            self._sum += moments[0]
            self._sum_of_squares += moments[1]
            self._max_score = max(self._max_score, moments[2])
            self._depth_profile += profile
            self.n_histories += HISTORIES_PER_CHUNK

    def estimate(self) -> tuple[float, float, float]:
        """Return the mean, its standard error, and the heaviest family's share of the sum."""
        mean = self._sum / self.n_histories
        stderr = np.sqrt(
            max(self._sum_of_squares / self.n_histories - mean**2, 0.0) / self.n_histories
        )
        share = self._max_score / self._sum if self._sum > 0.0 else 1.0
        return float(mean), float(stderr), float(share)

    def estimate_attenuation_rate(self, depth: float, fallback: float) -> float:
        """Return the rate (1/m) at which the weight falls off with depth, as far as it was seen."""
        count, weight = self._depth_profile
        # Neither the slice at the top nor that at the bottom, where light escapes.
        inside = (count >= _MIN_SLICE_COLLISIONS) & (weight > 0.0)
        inside[[0, -1]] = False
        if inside.sum() < 3:
            return fallback
        place = depth * (np.arange(N_DEPTH_SLICES)[inside] + 0.5) / N_DEPTH_SLICES
        return max(-float(np.polyfit(place, np.log(weight[inside]), 1)[0]), 0.0)


def _run_pilots(
    tracer: _HistoryTracer, first_stream: int, initial_rate: float, depth: float
) -> float:
    """Return the rate (1/m) at which rays are to be split, as pilots see the light fall off."""
    rate = _RATE_SAFETY_FACTOR * initial_rate
    for stage in range(N_PILOTS):
        pilot = _TransmittanceTally()
        pilot.trace_histories(tracer, first_stream + stage, PILOT_HISTORIES, rate)
        rate = min(pilot.estimate_attenuation_rate(depth, rate), initial_rate)
    return rate


def estimate_attenuation_rate(
    medium: GranularMedium, wavelengths: np.ndarray, seed: int, threads: int | None
) -> np.ndarray:
    """Return the rate (1/m) at which diffuse light falls off with depth, by diffusion theory.

    √(3 (1 − ω)(1 − ωg)) times the extinction (Ishimaru 1978, Wave Propagation and Scattering in
    Random Media, section 9.1), from the medium's single-scattering properties.
    """
    optics = single_scattering(medium, wavelengths, 1, OPTICS_RAYS, seed, threads)
    albedo = optics.single_scattering_albedo.values
    asymmetry = optics.asymmetry_parameter.values
    loss = np.clip(3.0 * (1.0 - albedo) * (1.0 - albedo * asymmetry), 0.0, 3.0)
    return optics.extinction.values * np.sqrt(loss)
