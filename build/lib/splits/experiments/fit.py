"""Which sand has a measured spectrum: least squares over what SPLITS Table 2 leaves open.

Every simulation of a stage uses the same random numbers, so that the misfit is a smooth function
of the parameters, bent a little towards that stage's noise; later stages use other numbers and
more rays, and the sand found is simulated afresh in the end.  A spectrum seldom fixes all
parameters: the error of each says how far it may move before the misfit tells.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from splits.checks import in_range, refuse
from splits.experiments.fit_errors import covariance_of, draws_of, parameter_errors
from splits.experiments.parameters import Cube, FitResult
from splits.instruments import spectrophotometer
from splits.instruments.arguments import check_incidence, check_wavelengths, check_whole
from splits.instruments.fixed import fixed_spectrum, spread_rows

STEP = 0.05
"""Difference of a coordinate for derivatives: large enough against what noise is not shared."""
JACOBIANS = 4
"""Independent Jacobians behind the errors."""
_RAYS_PER_DERIVATIVE = 8
"""The last stage's rays over those of each: there are many, and noise in them does not bias."""
FIRST_RADIUS = 0.3
"""Half the edge of the first trust region."""
_LEAST_RADIUS = 0.02
_LEAST_GAIN = 0.003
"""A descent ends once its trust region, or the relative gain foretold, falls below these."""

Model = Callable[[np.ndarray], np.ndarray]
"""Spectrum as a function of the place in the unit cube."""


@dataclass(frozen=True)
class Effort:
    """How much a fit may cost.

    Attributes
    ----------
    points : int
        Sands of the first survey, a power of 2.
    starts : tuple of int
        How many of the best sands each stage of descent begins with, the survey's first.
    evaluations : tuple of int
        Simulations that each descent may take, by stage.
    rays : tuple of int
        Rays per node of the survey and of every stage.
    max_stderr : float
        Standard error of the last spectrum, 1e-6 to 0.5.
    """

    points: int = 128
    starts: tuple[int, ...] = (6, 3, 1)
    evaluations: tuple[int, ...] = (40, 40, 40)
    rays: tuple[int, ...] = (512, 512, 2048, 16_384)
    max_stderr: float = 0.002

    def __post_init__(self) -> None:
        if not len(self.starts) == len(self.evaluations) == len(self.rays) - 1:
            raise refuse("effort", self, "starts, evaluations and rays for the same stages")


def fit(
    base_settings: Mapping[str, Any],
    wavelength_nm: Any,
    measured: Any,
    incidence_deg: float | str,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    seed: int = 1,
    threads: int | None = None,
    say: Callable[[str], None] = lambda line: None,
    *,
    effort: Effort | None = None,
) -> FitResult:
    """Find the sand whose reflectance comes nearest to a measured one.

    Parameters
    ----------
    base_settings : mapping
        Keywords of `splits.Sand` that stay fixed, for example ``refractive_index``.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), more than there are coordinates.
    measured : array_like
        Hemispherical reflectance there, 0 to 1.
    incidence_deg : float or "diffuse"
        Polar angle of the beam it was measured under, 0 to 89.9999 degrees.
    ranges : mapping, optional
        (low, high) by name, instead of those of `splits.experiments.parameters.RANGES`.
    seed : int
        Non-negative; the same seed gives the same result on any number of threads.
    threads : int, optional
    say : callable
        Receives lines of progress.
    effort : Effort, optional

    Raises
    ------
    ValueError
        For a value outside its range.
    """
    begun = time.perf_counter()
    effort = effort or Effort()
    wavelengths = check_wavelengths(wavelength_nm)
    wanted = check_measured(measured, len(wavelengths))
    cube = Cube(base_settings, ranges)
    if len(wavelengths) <= len(cube.names):
        raise refuse(
            "wavelength_nm", wavelengths.tolist(), f"more than {len(cube.names)} wavelengths"
        )
    entropy = np.random.SeedSequence(check_whole("seed", seed, 0))
    survey, *streams = (int(s) for s in entropy.generate_state(2 + len(effort.starts) + JACOBIANS))
    problem = _Problem(cube, wavelengths, wanted, check_incidence(incidence_deg), threads)

    ends = _search(problem, effort, survey, streams, say)
    best = ends[-1][0].place
    spectrum = spectrophotometer(
        cube.sand(best), wavelengths, incidence_deg, effort.max_stderr, streams[-1], threads=threads
    )
    modelled, stderr = spectrum.reflectance.values, spectrum.reflectance_stderr.values
    value, value_stderr = _misfit(modelled, wanted), float(np.sqrt(np.mean(stderr**2)))
    draws = draws_of(best, _covariance(problem, best, effort, streams, modelled))
    seconds = time.perf_counter() - begun
    say(f"{problem.count} sands, rmse {value:.4f} ± {value_stderr:.4f}, {seconds:.0f} s")
    return FitResult(
        parameters=parameter_errors(cube, best, draws),
        settings=cube.settings(best),
        rmse=value,
        rmse_stderr=value_stderr,
        wavelength_nm=wavelengths,
        measured=wanted,
        modelled=modelled,
        modelled_stderr=stderr,
        spectrum=spectrum,
        names=cube.names,
        coordinates=best,
        coordinates_stderr=np.sqrt(np.mean((draws - best) ** 2, axis=0)),
        correlation=np.corrcoef(draws, rowvar=False),
        others=[(end.misfit, cube.natural(end.place)) for end in ends[0]],
        evaluations=problem.count,
        seconds=seconds,
    )


class _Candidate(NamedTuple):
    """A place in the unit cube and the misfit found there."""

    misfit: float
    place: np.ndarray


@dataclass
class _Problem:
    """The spectrum wanted, the sands allowed, and the simulations so far."""

    cube: Cube
    wavelengths: np.ndarray
    wanted: np.ndarray
    incidence_deg: float | str
    threads: int | None
    count: int = 0

    def simulate(self, x: np.ndarray, rays: int, stream: int) -> tuple[np.ndarray, np.ndarray]:
        """Return reflectance at a place of the cube and how far groups of rays take it off."""
        self.count += 1
        mean, _, groups = fixed_spectrum(
            self.cube.sand(x),
            self.wavelengths,
            self.incidence_deg,
            spread_rows(len(self.wavelengths)),
            rays,
            stream,
            self.threads,
        )
        return mean[0], groups[:, 0]

    def model(self, rays: int, stream: int) -> Model:
        """Return reflectance as a function of the place, with so many rays of one stream."""
        return lambda x: self.simulate(x, rays, stream)[0]


def _search(
    problem: _Problem,
    effort: Effort,
    survey: int,
    streams: Sequence[int],
    say: Callable[[str], None],
) -> list[list[_Candidate]]:
    """Return where the descents of every stage ended, best first."""
    from scipy.stats import qmc  # a second, which every start of the workflow would take

    model = problem.model(effort.rays[0], survey)
    places = qmc.Sobol(len(problem.cube.names), seed=survey).random(effort.points)
    found = [_Candidate(_misfit(model(x), problem.wanted), x) for x in places]
    ends = []
    for stage, (starts, most) in enumerate(zip(effort.starts, effort.evaluations, strict=True)):
        found = sorted(found, key=lambda c: c.misfit)[:starts]
        say(f"{problem.count} sands, best misfit {found[0].misfit:.4f}")
        model = problem.model(effort.rays[stage + 1], streams[stage])
        # A later stage begins near its goal: it may trust its linear model less far.
        found = [
            descend(model, c.place, problem.wanted, most, FIRST_RADIUS / 2**stage) for c in found
        ]
        ends.append(sorted(found, key=lambda c: c.misfit))
    say(f"{problem.count} sands, best misfit {ends[-1][0].misfit:.4f}; now its errors")
    return ends


def _covariance(
    problem: _Problem, best: np.ndarray, effort: Effort, streams: Sequence[int], fresh: np.ndarray
) -> np.ndarray:
    """Return the covariance of the coordinates, from derivatives with numbers of their own."""
    last = len(effort.starts) - 1
    noise = problem.simulate(best, effort.rays[-1], streams[last])[1]
    rays = max(effort.rays[-1] // _RAYS_PER_DERIVATIVE, 1)
    jacobians = [central(problem.model(rays, s), best) for s in streams[last + 1 : -1]]
    return covariance_of(jacobians, fresh - problem.wanted, noise)


def _misfit(spectrum: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.sqrt(np.mean((spectrum - wanted) ** 2)))


def check_measured(measured: Any, count: int) -> np.ndarray:
    """Return measured reflectances as an array of so many, each in [0, 1], or refuse them."""
    try:
        values = np.asarray(measured, dtype=float)
    except (TypeError, ValueError):
        raise refuse("measured", measured, "numbers in [0, 1]") from None
    if values.shape != (count,):
        raise refuse(
            "measured", f"of shape {values.shape}", f"{count} numbers, one for each wavelength"
        )
    for value in values:
        in_range("measured", float(value), 0.0, 1.0)
    return values


def descend(
    model: Model,
    start: np.ndarray,
    wanted: np.ndarray,
    evaluations: int,
    radius: float,
) -> _Candidate:
    """Return the misfit and the place of the nearest spectrum found, by Gauss-Newton in a box.

    Every step minimises the linear model within the unit cube and a trust region around the best
    place so far.  Derivatives are differences, updated after Broyden (1965) as long as they
    foretell the misfit, because every simulation costs the same.

    Parameters
    ----------
    model : callable
        Spectrum at a place in the unit cube.
    start : float, shape (coordinates,)
    wanted : float, shape (wavelengths,)
    evaluations : int
        About how often the model may be called.
    radius : float
        Half the edge of the first trust region, 0 to 1.
    """
    from scipy.optimize import lsq_linear

    x = start.copy()
    f = model(x)
    best = float(np.sum((f - wanted) ** 2))
    used, stale = 1, True
    jacobian = np.empty((len(f), len(x)))
    while used < evaluations and radius >= _LEAST_RADIUS:
        fresh = stale
        if stale:
            jacobian = _forward(model, x, f)
            used += len(x)
            stale = False
        low, high = np.maximum(-x, -radius), np.minimum(1.0 - x, radius)
        step = lsq_linear(jacobian, wanted - f, (low - 1e-9, high + 1e-9)).x
        step = np.clip(x + step, 0.0, 1.0) - x
        foretold = best - float(np.sum((f + jacobian @ step - wanted) ** 2))
        if foretold < _LEAST_GAIN * best:
            if fresh:
                break
            stale = True
            continue
        g = model(x + step)
        used += 1
        gained = best - float(np.sum((g - wanted) ** 2))
        jacobian += np.outer(g - f - jacobian @ step, step) / (step @ step)
        if gained < 0.25 * foretold:
            radius *= 0.5
        elif gained > 0.75 * foretold:
            radius = min(2.0 * radius, 0.5)
        stale = gained < 0.5 * foretold and not (fresh and gained <= 0.0)
        if gained > 0.0:
            x, f, best = x + step, g, best - gained
    return _Candidate(float(np.sqrt(best / len(wanted))), x)


def _forward(model: Model, x: np.ndarray, f: np.ndarray) -> np.ndarray:
    """Return derivatives from one neighbour per coordinate, inside the cube."""
    columns = []
    for i in range(len(x)):
        near = x.copy()
        near[i] += STEP if x[i] + STEP <= 1.0 else -STEP
        columns.append((model(near) - f) / (near[i] - x[i]))
    return np.column_stack(columns)


def central(model: Model, x: np.ndarray) -> np.ndarray:
    """Return derivatives between neighbours on both sides, as far as the cube reaches."""
    columns = []
    for i in range(len(x)):
        up, down = x.copy(), x.copy()
        up[i] = min(x[i] + 2.0 * STEP, 1.0)
        down[i] = max(x[i] - 2.0 * STEP, 0.0)
        columns.append((model(up) - model(down)) / (up[i] - down[i]))
    return np.column_stack(columns)
