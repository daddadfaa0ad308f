"""Derivatives of spectra: accuracy against differences of long runs, and cost of each method.

    python benchmarks/derivatives.py [--max-stderr 0.002] [--seeds 1] [--media "natural snow" sand]

1. Every parameter of five media at six wavelengths, against five-point differences of independent
   runs with half the error, for each seed.  Wavelengths use the same rays, so the rms z of one
   parameter scatters; the criterion is that of all parameters.
2. Cost of derivatives from the same paths, relative to the spectrum alone.
3. For the other parameters, variance times seconds of one core of common random numbers, and, where
   only attenuation changes, of likelihood ratios (a path of n segments of total length l has
   d ln p / d ln μ = n − μ l).  It is divided by that of differences of independent runs, for two
   choices: five points with a step whose truncation error is below the noise; and the best of two
   rules and several steps, which is known only afterwards, with noise and truncation error in the
   same time.
"""

import argparse
import itertools
import statistics
import time
from typing import Any, NamedTuple

import numpy as np

import splits
from splits.kernels.records import (
    EXIT_LENGTH,
    EXIT_ORDER,
    EXIT_SIDE,
    EXIT_WEIGHT,
)
from splits.media.parameters import INCIDENCE_KEY, get_parameter, replace_parameter
from splits.simulation.engine import simulate
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import build_scene, compute_optical_constants
from splits.simulation.spectral_nodes import IndexNodes
from splits.simulation.strata import StoppingRule, Stratum
from splits.simulation.tally import ExitTally

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
        "ground": 0.1, "refractive_index": 0.05, INCIDENCE_KEY: 5,
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
"""Media, and for each parameter the step of the differences of long runs."""
STEP_FACTORS = (0.5, 1.0, 2.0, 4.0)
"""Factors of these steps for differences of independent runs."""
SEEDS = range(101, 109)
"""Seeds from which the error of these differences is estimated."""
DIFFERENCE_RULES = {2: {-1: -0.5, 1: 0.5}, 5: {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}}
"""Weights of central differences by distance in steps, for each number of points."""
KEEP_OVERLAPS = {"overlap_with_previous_segment": "keep", "overlap_with_boundary": "keep"}
"""Interpretation with exponential segments, as likelihood ratios assume."""
EXACT_PARAMETERS = {
    "natural snow": [SOOT, "algae_cells_ml.snow_algae", "ground"],
    "deep snow": [SOOT, "algae_cells_ml.snow_algae", "optical_radius_um"],
    "two layers": ["ground", f"layers.0.{SOOT}", f"layers.1.{SOOT}"],
}


def select_wavelengths(medium: Any) -> list[float]:
    """Return the wavelengths of a medium, only one for a particle layer."""
    return WAVELENGTHS_NM[:1] if medium.kind == "particle_layer" else WAVELENGTHS_NM


def time_spectrum(
    medium: Any, error: float, seed: int, incidence: float = INCIDENCE_DEG, **settings: Any
) -> Any:
    """Return a spectrum and its processor time (s)."""
    start = time.process_time()
    result = splits.spectrophotometer(
        medium,
        select_wavelengths(medium),
        incidence,
        max_stderr=error,
        seed=seed,
        **settings,
        solver="monte_carlo",
    )
    return result, time.process_time() - start


def shift_parameter(medium: Any, name: str, change: float) -> tuple[Any, float]:
    """Return a medium and an angle of incidence with a changed parameter."""
    if name == INCIDENCE_KEY:
        return medium, INCIDENCE_DEG + change
    return replace_parameter(medium, name, get_parameter(medium, name) + change), INCIDENCE_DEG


def compute_long_difference(medium: Any, name: str, step: float, error: float, seed: int) -> Any:
    """Return a five-point difference of independent runs, and its standard error."""
    value, square = 0.0, 0.0
    for number, (distance, weight) in enumerate(DIFFERENCE_RULES[5].items()):
        changed_medium, incidence = shift_parameter(medium, name, distance * step)
        run, _ = time_spectrum(changed_medium, error, seed + number, incidence)
        value = value + weight / step * run.reflectance.values
        square = square + (weight / step * run.reflectance_stderr.values) ** 2
    return value, np.sqrt(square)


def compare_derivatives(labels: list[str], error: float, seeds: int) -> None:
    """Compare all derivatives with differences of long runs."""
    all_z = []
    for label in labels:
        medium, steps = MEDIA[label]
        for number, (name, step) in enumerate(steps.items()):
            parameter_z = []
            for seed in range(1, seeds + 1):
                result, _ = time_spectrum(medium, error, seed, jacobian=[name])
                first = 1000 * seed + 10 * number
                difference, stderr = compute_long_difference(medium, name, step, 0.5 * error, first)
                derivative = result.reflectance_jacobian.values[0]
                derivative_stderr = result.reflectance_jacobian_stderr.values[0]
                parameter_z.append((derivative - difference) / np.hypot(derivative_stderr, stderr))
            all_z.append(np.concatenate(parameter_z))
            print(
                f"{label:13} {name:32} {result.parameter_method.values[0]:12} rms z "
                f"{np.sqrt((all_z[-1] ** 2).mean()):.2f}, at {select_wavelengths(medium)[0]:g} nm "
                f"{derivative[0]:.4g} ± {derivative_stderr[0]:.2g}, "
                f"long runs {difference[0]:.4g} ± {stderr[0]:.2g}",
                flush=True,
            )
    z = np.concatenate(all_z)
    bound = statistics.NormalDist().inv_cdf(0.5 + 0.5 * 0.99 ** (1.0 / z.size))
    print(f"{z.size} derivatives: rms z {np.sqrt((z**2).mean()):.3f}, largest {abs(z).max():.2f} "
          f"(99 % bound {bound:.2f})")  # fmt: skip


def report_exact_cost(error: float) -> None:
    """Print the cost of derivatives from the same paths, relative to the spectrum alone."""
    for label, names in EXACT_PARAMETERS.items():
        medium = MEDIA[label][0]
        pairs = [
            [
                time_spectrum(medium, error, seed, jacobian=names_of_run)[1]
                for names_of_run in ([], names)
            ]
            for seed in range(1, 8)
        ]
        spectrum_s, with_derivatives_s = np.median(pairs, axis=0)
        print(
            f"{label}: {', '.join(names)} cost {with_derivatives_s / spectrum_s:.2f} times "
            "the spectrum alone"
        )


class ScoreTally(ExitTally):
    """Sums of reflected weights times the score function of attenuation, from a single node.

    Attributes
    ----------
    sums : float, shape (2, wavelengths)
        Sums and sums of squares over the rays.
    """

    first_stream = 0
    values_per_row = 2

    def __init__(self, nodes: IndexNodes, absorption: np.ndarray, attenuation: float) -> None:
        super().__init__(nodes, absorption)
        self.attenuation, self.sums = attenuation, np.zeros((2, len(absorption)))
        self.add_strata()

    def score(self, stratum: Stratum, exits: np.ndarray, crossings: np.ndarray) -> np.ndarray:
        """Return sums and sums of squares over the rays of a chunk, by wavelength."""
        lengths = exits[:, EXIT_LENGTH:]
        weight = exits[:, EXIT_WEIGHT, None] * np.exp(-lengths @ self.absorption.T)
        score = exits[:, EXIT_ORDER] - self.attenuation * lengths[:, 0]
        # Rows of rays that ended inside are invalid.
        reflected = exits[:, EXIT_SIDE] == 0.0
        scores = np.where(reflected[:, None], weight * score[:, None], 0.0)
        return np.stack([scores.sum(axis=0), (scores**2).sum(axis=0)])

    def merge(self, stratum: Stratum, score: np.ndarray) -> None:
        """Add the sums of the next chunk."""
        self.sums += score


def compute_likelihood_ratio(medium: Any, rays: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the derivative by the logarithm of attenuation, its variance, and the time (s)."""
    start = time.process_time()
    n_wavelengths = len(WAVELENGTHS_NM)
    index, absorption = compute_optical_constants(medium, np.array(WAVELENGTHS_NM))
    middle = n_wavelengths // 2
    nodes = IndexNodes(
        index[middle : middle + 1], np.ones((1, n_wavelengths)), np.zeros(n_wavelengths)
    )
    tally = ScoreTally(nodes, absorption, 1.0 / medium.mean_free_path_m)
    run = RunOptions.start(1, None)
    scene = build_scene(medium, INCIDENCE_DEG, False)
    simulate(scene, tally, StoppingRule(0.0, rays, fixed=True), run)
    n_rays = tally.n_rays
    mean = tally.sums[0] / n_rays
    variance = (tally.sums[1] / n_rays - mean**2) / n_rays
    return mean, variance, time.process_time() - start


class IndependentDifferences(NamedTuple):
    """Best differences of independent runs.

    Attributes
    ----------
    mean_square : float, shape (wavelengths,)
        Mean square error.
    n_points : int
        Number of points of the rule.
    step : float
    default_mean_square : float, shape (wavelengths,)
        Mean square error of five points with the default step.
    """

    mean_square: np.ndarray
    n_points: int
    step: float
    default_mean_square: np.ndarray

    def format_ratio(self, square: np.ndarray) -> str:
        """Return the ratios of another mean square error to both, as text."""
        best_ratio, default_ratio = (
            np.median(square / reference)
            for reference in (self.mean_square, self.default_mean_square)
        )
        return f"{default_ratio:.2f} ({best_ratio:.2f})"


def optimize_independent(
    medium: Any, name: str, step: float, error: float, time_s: float
) -> IndependentDifferences:
    """Return the error of differences of independent runs for a given processor time.

    The truncation error of a step is estimated from runs that use the same random numbers as a
    derivative.  Products of estimates with different seeds are unbiased for its square.
    """
    around = [_simulate_around(medium, name, step, error, seed) for seed in SEEDS]
    derivatives = [
        time_spectrum(medium, error, seed, jacobian=[name])[0].reflectance_jacobian.values[0]
        for seed in SEEDS
    ]
    candidates, default_mean_square = [], np.empty(0)
    for factor, (points, rule) in itertools.product(STEP_FACTORS, DIFFERENCE_RULES.items()):
        if not all(factor * distance in around[0] for distance in rule):
            continue
        terms = [[(runs[factor * x], w / (factor * step)) for x, w in rule.items()]
                 for runs in around]  # fmt: skip
        deviation = (
            np.stack([sum(w * run.values for run, w in term) for term in terms]) - derivatives
        )
        truncation_square = (deviation.sum(axis=0) ** 2 - (deviation**2).sum(axis=0)) / (
            len(SEEDS) * (len(SEEDS) - 1)
        )
        noise = np.mean([sum((w * run.stderr) ** 2 for run, w in term) for term in terms], axis=0)
        seconds = np.mean([sum(run.seconds for run, _ in term) for term in terms])
        mean_square = noise * seconds / time_s + np.maximum(truncation_square, 0.0)
        candidates.append(IndependentDifferences(mean_square, points, factor * step, mean_square))
        if factor == 1.0 and points == 5:
            default_mean_square = noise * seconds / time_s
    best = min(candidates, key=lambda one: float(np.median(one.mean_square)))
    return best._replace(default_mean_square=default_mean_square)


class TimedSpectrum(NamedTuple):
    """A spectrum, its standard errors, and its processor time (s)."""

    values: np.ndarray
    stderr: np.ndarray
    seconds: float


def _simulate_around(
    medium: Any, name: str, step: float, error: float, seed: int
) -> dict[float, TimedSpectrum]:
    """Return runs around a value within its range, by distance in steps."""
    spectra = {}
    for distance in sorted(
        {f * x for f in STEP_FACTORS for rule in DIFFERENCE_RULES.values() for x in rule}
    ):
        try:
            changed_medium, incidence = shift_parameter(medium, name, distance * step)
            run, seconds = time_spectrum(changed_medium, error, seed, incidence)
        except ValueError:
            continue
        spectra[distance] = TimedSpectrum(
            run.reflectance.values, run.reflectance_stderr.values, seconds
        )
    return spectra


def compare_methods(labels: list[str], error: float) -> None:
    """Print the cost of each method relative to independent runs, the best of these in brackets."""
    for label in labels:
        medium, steps = MEDIA[label]
        for name, step in steps.items():
            result, seconds = time_spectrum(medium, error, 1, jacobian=[name])
            if result.parameter_method.values[0] == "shared_paths":
                continue
            time_s = seconds - time_spectrum(medium, error, 1)[1]
            variance = result.reflectance_jacobian_stderr.values[0] ** 2
            independent = optimize_independent(medium, name, step, error, time_s)
            print(
                f"{label:13} {name:28} common random numbers {independent.format_ratio(variance)}, "
                f"the best: {independent.n_points} points, step {independent.step:g}", flush=True,
            )  # fmt: skip
    report_attenuation_cost(error)
    report_similarity_cost(error)


def report_similarity_cost(error: float) -> None:
    """Print the cost of similarity: r ∂R/∂r is a sum over paths minus D ∂R/∂D, D the depth."""
    medium, steps = MEDIA["natural snow"]
    size, depth = "optical_radius_um", "depth_m"
    ratio = get_parameter(medium, depth) / get_parameter(medium, size)
    spectrum_s = time_spectrum(medium, error, 1)[1]
    result, seconds = time_spectrum(medium, error, 1, jacobian=[size])
    depth_result, depth_s = time_spectrum(medium, error, 1, jacobian=[depth])
    independent = optimize_independent(medium, size, steps[size], error, seconds - spectrum_s)
    variance = result.reflectance_jacobian_stderr.values[0] ** 2
    similarity_variance = (ratio * depth_result.reflectance_jacobian_stderr.values[0]) ** 2
    similarity_variance *= (depth_s - spectrum_s) / (seconds - spectrum_s)
    print(
        f"natural snow, size: common random numbers {independent.format_ratio(variance)}, "
        f"similarity at least {independent.format_ratio(similarity_variance)}, from the derivative "
        "by depth alone"
    )


def report_attenuation_cost(error: float) -> None:
    """Print the cost of likelihood ratios, where only attenuation changes."""
    for label, depth in (("2 cm of snow", 0.02), ("30 cm of snow", 0.3)):
        soot = {"black_carbon": 100}
        medium = splits.Snow.natural(
            optical_radius_um=150, depth_m=depth, density_kg_m3=200, impurities_ng_g=soot,
            interpretation=KEEP_OVERLAPS,
        )  # fmt: skip
        time_spectrum(medium, 0.02, 1)
        result, seconds = time_spectrum(medium, error, 1, jacobian=["density_kg_m3"])
        time_s = seconds - time_spectrum(medium, error, 1)[1]
        difference, stderr = compute_long_difference(medium, "density_kg_m3", 20.0, error, 100)
        independent = optimize_independent(medium, "density_kg_m3", 20.0, error, time_s)
        # Grains do not change, so attenuation is the inverse of the mean free path.
        attenuations = [
            1.0 / replace_parameter(medium, "density_kg_m3", x).mean_free_path_m
            for x in (199.0, 201.0)
        ]
        rate = 0.5 * np.log(attenuations[1] / attenuations[0])
        mean, variance, ratio_s = compute_likelihood_ratio(medium, 100_000)
        common_variance = result.reflectance_jacobian_stderr.values[0] ** 2
        ratio_variance = rate**2 * variance * ratio_s / time_s
        z = (rate * mean - difference) / np.hypot(rate * np.sqrt(variance), stderr)
        print(
            f"{label}, density: common random numbers {independent.format_ratio(common_variance)}, "
            f"likelihood ratio {independent.format_ratio(ratio_variance)}, "
            f"its rms z {np.sqrt((z**2).mean()):.2f}"
        )


def main() -> None:
    """Print all three parts."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--max-stderr", type=float, default=0.002)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--methods-only", action="store_true", help="part 3 only")
    parser.add_argument("--media", nargs="+", default=list(MEDIA), choices=list(MEDIA))
    arguments = parser.parse_args()
    for label in arguments.media:
        time_spectrum(MEDIA[label][0], 0.05, 1)
    if not arguments.methods_only:
        compare_derivatives(arguments.media, arguments.max_stderr, arguments.seeds)
        report_exact_cost(arguments.max_stderr)
    compare_methods(arguments.media, arguments.max_stderr)


if __name__ == "__main__":
    main()
