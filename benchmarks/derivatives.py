"""Derivatives of spectra: against differences of long runs, and what each way to them costs.

    python benchmarks/derivatives.py [--max-stderr 0.002] [--seeds 1] [--media "natural snow" sand]

1. Every parameter of five media at six wavelengths, against five-point differences of runs with
   random numbers of their own to half the error, for each of so many seeds.  Wavelengths share
   rays, so rms z of one parameter scatters; that of all is what counts.
2. What those that leave the paths as they are cost beside the spectrum alone.
3. Of the others: variance times seconds of one core, for runs that share random numbers, and,
   where attenuation is all that changes, for likelihood ratios (a path of n legs of total length l
   has d ln p / d ln μ = n − μ l).  In units of that of independent runs twice: with five points, a
   step so small that the rule is off by less than noise; and at their best, the better of two
   rules at the best of some steps, which is known afterwards only: what these are off by, from
   noise and from the step, in as much time.
"""

from __future__ import annotations

import argparse
import itertools
import statistics
import time
from typing import Any, NamedTuple

import numpy as np

import splits
from splits.kernels.tallies.exits import (
    EXIT_LENGTH,
    EXIT_ORDER,
    EXIT_SIDE,
    EXIT_WEIGHT,
    REFLECTED,
)
from splits.media.medium import compute_mean_free_path_m
from splits.media.parameters import INCIDENCE_KEY, get_parameter, replace_parameter
from splits.simulation.fixed_budget import SINGLE_STRATUM
from splits.simulation.runner import Runner
from splits.simulation.scene import compute_optical_constants
from splits.simulation.tally import PathTally

WAVELENGTHS_NM = [450.0, 600.0, 700.0, 800.0, 900.0, 1000.0]
INCIDENCE_DEG = 40.0
SOOT = "impurities_ng_g.black_carbon"
SNOW = splits.Snow.natural(
    optical_radius_um=150, depth_m=0.02, density_kg_m3=200, ground=0.2, facetness=(0.2,) * 3 + (0,),
    impurities_ng_g={"black_carbon": 100}, liquid_water_content=0.03,
)  # fmt: skip
SAND = splits.Sand(
    hematite_ratio=0.3, magnetite=0.02, saturation=0.3, texture=(0, 0.1, 0.9)
)  # fmt: skip
MEDIA: dict[str, Any] = {
    "natural snow": (SNOW, {
        SOOT: 50, "ground": 0.1, "optical_radius_um": 15, "specific_surface_area_m2_kg": 2,
        "liquid_water_content": 0.012, "density_kg_m3": 20, "depth_m": 0.002, "facetness": 0.05,
        "sphericity": 0.05, INCIDENCE_KEY: 5,
    }),
    "deep snow": (
        splits.Snow.natural(optical_radius_um=150, impurities_ng_g={"black_carbon": 100}),
        {SOOT: 50, "optical_radius_um": 30, "specific_surface_area_m2_kg": 4},
    ),
    "sand": (SAND, {
        "iron_oxide": 0.002, "hematite_ratio": 0.1, "magnetite": 0.005, "saturation": 0.1,
        "porosity": 0.05, "sphericity": 0.02, "partition.coated": 0.08, "texture.silt": 0.02,
        INCIDENCE_KEY: 5,
    }),
    "layer": (splits.ParticleLayer(optical_thickness=3), {
        "optical_thickness": 0.5, "single_scattering_albedo": 0.004, "asymmetry": 0.04,
        "bottom_albedo": 0.1, "refractive_index": 0.05, INCIDENCE_KEY: 5,
    }),
    "two layers": (
        splits.Stack([
            splits.Snow.natural(optical_radius_um=80, depth_m=0.005,
                                impurities_ng_g={"black_carbon": 100}),
            splits.Snow.natural(optical_radius_um=400, depth_m=0.05,
                                impurities_ng_g={"black_carbon": 200}),
        ], ground=0.3),
        {"ground": 0.1, f"layers.0.{SOOT}": 50, f"layers.1.{SOOT}": 50, "layers.0.depth_m": 0.001,
         "layers.0.optical_radius_um": 10, "layers.1.optical_radius_um": 50},
    ),
}  # fmt: skip
"""Media, and steps of the differences of long runs."""
STEP_FACTORS = (0.5, 1.0, 2.0, 4.0)
"""Of these steps, for differences of independent runs."""
SEEDS = range(101, 109)
"""Of what these are off by."""
DIFFERENCE_RULES = {2: {-1: -0.5, 1: 0.5}, 5: {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}}
"""Weights of central differences, by distance in steps, for rules of so many points."""
KEEP_OVERLAPS = {"overlap_with_previous_segment": "keep", "overlap_with_boundary": "keep"}
"""Legs as likelihood ratios take them: exponential, whatever fits."""
EXACT_PARAMETERS = {
    "natural snow": [SOOT, "algae_cells_ml.snow_algae", "ground"],
    "deep snow": [SOOT, "algae_cells_ml.snow_algae", "optical_radius_um"],
    "two layers": ["ground", f"layers.0.{SOOT}", f"layers.1.{SOOT}"],
}


def select_wavelengths(medium: Any) -> list[float]:
    """Return the wavelengths of a medium; a layer has no colour."""
    return WAVELENGTHS_NM[:1] if medium.kind == "particle_layer" else WAVELENGTHS_NM


def time_spectrum(
    medium: Any, error: float, seed: int, incidence: float = INCIDENCE_DEG, **more: Any
) -> Any:
    """Return a spectrum and the seconds of processors that it took."""
    begun = time.process_time()
    found = splits.spectrophotometer(
        medium, select_wavelengths(medium), incidence, error, seed, **more
    )
    return found, time.process_time() - begun


def shift_parameter(medium: Any, name: str, change: float) -> tuple[Any, float]:
    """Return a medium and an incidence with a parameter moved."""
    if name == INCIDENCE_KEY:
        return medium, INCIDENCE_DEG + change
    return replace_parameter(medium, name, get_parameter(medium, name) + change), INCIDENCE_DEG


def compute_long_difference(medium: Any, name: str, step: float, error: float, seed: int) -> Any:
    """Return a five-point difference of runs with random numbers of their own, and its error."""
    value, square = 0.0, 0.0
    for number, (place, weight) in enumerate(DIFFERENCE_RULES[5].items()):
        other, incidence = shift_parameter(medium, name, place * step)
        run, _ = time_spectrum(other, error, seed + number, incidence)
        value = value + weight / step * run.reflectance.values
        square = square + (weight / step * run.reflectance_stderr.values) ** 2
    return value, np.sqrt(square)


def compare_derivatives(labels: list[str], error: float, seeds: int) -> None:
    """Hold all derivatives against differences of long runs."""
    every = []
    for label in labels:
        medium, steps = MEDIA[label]
        for number, (name, step) in enumerate(steps.items()):
            some = []
            for seed in range(1, seeds + 1):
                found, _ = time_spectrum(medium, error, seed, jacobian=[name])
                first = 1000 * seed + 10 * number
                value, stderr = compute_long_difference(medium, name, step, 0.5 * error, first)
                own = found.reflectance_jacobian.values[0]
                own_error = found.reflectance_jacobian_stderr.values[0]
                some.append((own - value) / np.hypot(own_error, stderr))
            every.append(np.concatenate(some))
            print(
                f"{label:13} {name:32} {found.parameter_method.values[0]:12} rms z "
                f"{np.sqrt((every[-1] ** 2).mean()):.2f}, at {select_wavelengths(medium)[0]:g} nm "
                f"{own[0]:.4g} ± {own_error[0]:.2g}, long runs {value[0]:.4g} ± {stderr[0]:.2g}",
                flush=True,
            )
    z = np.concatenate(every)
    bound = statistics.NormalDist().inv_cdf(0.5 + 0.5 * 0.99 ** (1.0 / z.size))
    print(f"{z.size} derivatives: rms z {np.sqrt((z**2).mean()):.3f}, largest {abs(z).max():.2f} "
          f"(99 % bound {bound:.2f})")  # fmt: skip


def report_exact_cost(error: float) -> None:
    """Print what derivatives from the same paths cost beside the spectrum alone."""
    for label, names in EXACT_PARAMETERS.items():
        medium = MEDIA[label][0]
        pairs = [
            [time_spectrum(medium, error, seed, jacobian=some)[1] for some in ([], names)]
            for seed in range(1, 8)
        ]
        alone, both = np.median(pairs, axis=0)
        print(f"{label}: {', '.join(names)} cost {both / alone:.2f} times the spectrum alone")


class ScoreTally(PathTally):
    """Reflected weights times the score of attenuation, ray by ray."""

    sums: np.ndarray
    attenuation: float

    def score_chunk(
        self, stratum: Any, first_ray: int, exits: np.ndarray, crossings: np.ndarray
    ) -> Any:
        """Return sums and sums of squares over the rays of a batch, by wavelength."""
        lengths = exits[:, EXIT_LENGTH:]
        weight = exits[:, EXIT_WEIGHT, None] * np.exp(-lengths @ self.absorption.T)
        score = exits[:, EXIT_ORDER] - self.attenuation * lengths[:, 0]
        # Rows of rays that ended inside hold nothing.
        out = exits[:, EXIT_SIDE] == REFLECTED - 1
        both = np.where(out[:, None], weight * score[:, None], 0.0)
        return np.stack([both.sum(axis=0), (both**2).sum(axis=0)]), len(exits)

    def add_scores(self, stratum: Any, scores: Any) -> None:
        """Add batches up."""
        for sums, rays in scores:
            self.sums = self.sums + sums
            stratum.n_rays += rays


def compute_likelihood_ratio(medium: Any, rays: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the derivative to the logarithm of attenuation, its variance, and seconds."""
    begun = time.process_time()
    index, absorption = compute_optical_constants(medium, np.array(WAVELENGTHS_NM))
    runner = Runner(medium, INCIDENCE_DEG, 1, None, False)
    one = ScoreTally(
        0, index[len(WAVELENGTHS_NM) // 2], absorption, np.ones(len(WAVELENGTHS_NM), bool),
        runner.tracer.traits, bounds=SINGLE_STRATUM,
    )  # fmt: skip
    one.sums, one.attenuation = (
        np.zeros((2, len(WAVELENGTHS_NM))),
        1.0 / compute_mean_free_path_m(medium),
    )
    runner.trace([(one, level, rays) for level in one.strata], 1.0, 0.0)
    count = one.strata[0].n_rays
    mean = one.sums[0] / count
    variance = (one.sums[1] / count - mean**2) / count
    return mean, variance, time.process_time() - begun


class IndependentDifferences(NamedTuple):
    """Differences of independent runs, at their best.

    Attributes
    ----------
    square : float, shape (wavelengths,)
        Mean square of what they are off by.
    points : int
        Of the rule.
    step : float
    cautious : float, shape (wavelengths,)
        The same with five points at the step first thought of.
    """

    mean_square: np.ndarray
    n_points: int
    step: float
    default_mean_square: np.ndarray

    def format_ratio(self, square: np.ndarray) -> str:
        """Return how large another mean square is, beside both."""
        best, cautious = (
            np.median(square / own) for own in (self.mean_square, self.default_mean_square)
        )
        return f"{cautious:.2f} ({best:.2f})"


def optimize_independent(
    medium: Any, name: str, step: float, error: float, spent: float
) -> IndependentDifferences:
    """Return what differences of independent runs are off by, after so many seconds.

    What a step is off by comes from runs that share random numbers with a derivative, of several
    seeds: products of different seeds' estimates of it are right on average where squares are not.
    """
    around = [_simulate_around(medium, name, step, error, seed) for seed in SEEDS]
    truth = [
        time_spectrum(medium, error, seed, jacobian=[name])[0].reflectance_jacobian.values[0]
        for seed in SEEDS
    ]
    every, cautious = [], np.empty(0)
    for factor, (points, rule) in itertools.product(STEP_FACTORS, DIFFERENCE_RULES.items()):
        if not all(factor * place in around[0] for place in rule):
            continue
        terms = [[(runs[factor * x], w / (factor * step)) for x, w in rule.items()]
                 for runs in around]  # fmt: skip
        off = np.stack([sum(w * run.values for run, w in term) for term in terms]) - truth
        apart = (off.sum(axis=0) ** 2 - (off**2).sum(axis=0)) / (len(SEEDS) * (len(SEEDS) - 1))
        noise = np.mean([sum((w * run.stderr) ** 2 for run, w in term) for term in terms], axis=0)
        seconds = np.mean([sum(run.seconds for run, _ in term) for term in terms])
        square = noise * seconds / spent + np.maximum(apart, 0.0)
        every.append(IndependentDifferences(square, points, factor * step, square))
        if factor == 1.0 and points == 5:
            cautious = noise * seconds / spent
    best = min(every, key=lambda one: float(np.median(one.mean_square)))
    return best._replace(default_mean_square=cautious)


class TimedSpectrum(NamedTuple):
    """A spectrum, its standard errors, and the seconds that it took."""

    values: np.ndarray
    stderr: np.ndarray
    seconds: float


def _simulate_around(
    medium: Any, name: str, step: float, error: float, seed: int
) -> dict[float, TimedSpectrum]:
    """Return runs around a value, by distance in steps, as far as its range goes."""
    found = {}
    for distance in sorted(
        {f * x for f in STEP_FACTORS for rule in DIFFERENCE_RULES.values() for x in rule}
    ):
        try:
            other, incidence = shift_parameter(medium, name, distance * step)
            run, seconds = time_spectrum(other, error, seed, incidence)
        except ValueError:
            continue
        found[distance] = TimedSpectrum(
            run.reflectance.values, run.reflectance_stderr.values, seconds
        )
    return found


def compare_methods(labels: list[str], error: float) -> None:
    """Print variance times seconds of every way beside independent runs, these at best in ()."""
    for label in labels:
        medium, steps = MEDIA[label]
        for name, step in steps.items():
            found, seconds = time_spectrum(medium, error, 1, jacobian=[name])
            if found.parameter_method.values[0] == "shared_paths":
                continue
            spent = seconds - time_spectrum(medium, error, 1)[1]
            own = found.reflectance_jacobian_stderr.values[0] ** 2
            other = optimize_independent(medium, name, step, error, spent)
            print(
                f"{label:13} {name:28} common random numbers {other.format_ratio(own)}, "
                f"the best: {other.n_points} points, step {other.step:g}", flush=True,
            )  # fmt: skip
    report_attenuation_cost(error)
    report_similarity_cost(error)


def report_similarity_cost(error: float) -> None:
    """Print what similarity costs: r ∂R/∂r is a sum over paths less D ∂R/∂D, D the depth."""
    medium, steps = MEDIA["natural snow"]
    size, depth = "optical_radius_um", "depth_m"
    ratio = get_parameter(medium, depth) / get_parameter(medium, size)
    alone = time_spectrum(medium, error, 1)[1]
    found, seconds = time_spectrum(medium, error, 1, jacobian=[size])
    of_depth, seconds_depth = time_spectrum(medium, error, 1, jacobian=[depth])
    other = optimize_independent(medium, size, steps[size], error, seconds - alone)
    own = found.reflectance_jacobian_stderr.values[0] ** 2
    similar = (ratio * of_depth.reflectance_jacobian_stderr.values[0]) ** 2
    similar *= (seconds_depth - alone) / (seconds - alone)
    print(
        f"natural snow, size: common random numbers {other.format_ratio(own)}, similarity "
        f"at least {other.format_ratio(similar)}: its depth alone"
    )


def report_attenuation_cost(error: float) -> None:
    """Print what likelihood ratios cost, where attenuation is all that changes."""
    for label, depth in (("2 cm of snow", 0.02), ("30 cm of snow", 0.3)):
        soot = {"black_carbon": 100}
        medium = splits.Snow.natural(
            optical_radius_um=150, depth_m=depth, density_kg_m3=200, impurities_ng_g=soot,
            interpretation=KEEP_OVERLAPS,
        )  # fmt: skip
        time_spectrum(medium, 0.02, 1)
        found, seconds = time_spectrum(medium, error, 1, jacobian=["density_kg_m3"])
        spent = seconds - time_spectrum(medium, error, 1)[1]
        long, stderr = compute_long_difference(medium, "density_kg_m3", 20.0, error, 100)
        other = optimize_independent(medium, "density_kg_m3", 20.0, error, spent)
        # Grains stay as they are: attenuation is that of the mean leg.
        legs = [
            1.0 / compute_mean_free_path_m(replace_parameter(medium, "density_kg_m3", x))
            for x in (199.0, 201.0)
        ]
        rate = 0.5 * np.log(legs[1] / legs[0])
        mean, variance, took = compute_likelihood_ratio(medium, 100_000)
        own = found.reflectance_jacobian_stderr.values[0] ** 2
        ratio = rate**2 * variance * took / spent
        z = (rate * mean - long) / np.hypot(rate * np.sqrt(variance), stderr)
        print(
            f"{label}, density: common random numbers {other.format_ratio(own)}, likelihood ratio "
            f"{other.format_ratio(ratio)}, rms z of it {np.sqrt((z**2).mean()):.2f}"
        )


def main() -> None:
    """Print all three."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--max-stderr", type=float, default=0.002)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--ways-only", action="store_true", help="part 3 alone")
    parser.add_argument("--media", nargs="+", default=list(MEDIA), choices=list(MEDIA))
    given = parser.parse_args()
    for label in given.media:
        time_spectrum(MEDIA[label][0], 0.05, 1)
    if not given.ways_only:
        compare_derivatives(given.media, given.max_stderr, given.seeds)
        report_exact_cost(given.max_stderr)
    compare_methods(given.media, given.max_stderr)


if __name__ == "__main__":
    main()
