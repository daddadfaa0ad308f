"""Coverage of retrievals by discrete ordinates from spectra of simulated paths.

    RETRIEVALS=1008 pytest -s tests/campaigns/test_retrieval_coverage.py

retrieves 1008 snows, in about ten minutes.  True values are uniform in the coordinates of the
retrieval.  The spectra are those of paths, with noise of 1 % and 0.003 at each wavelength.  Snows
of a group have the same water and share their paths, so that their errors are correlated: the mean
z of groups of 112 scatters by up to 1, that of independent errors would by 0.1.
"""

import os
import time

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z
from scipy import stats

import splits
from splits.instruments.spectrophotometer import SpectralRequest, simulate_spectra
from splits.retrieval.optimal_estimation import N_DRAWS
from splits.simulation.run_options import RunOptions
from splits.simulation.shared_paths import group_by_shared_paths

RETRIEVALS = os.environ.get("RETRIEVALS")
FEW = 24
W = np.arange(400.0, 2401.0, 25.0)
SIZE, WATER, SOOT = "optical_radius_um", "liquid_water_content", "impurities_ng_g.black_carbon"
RANGES = {SIZE: (50.0, 1500.0), WATER: (0.0, 0.15), SOOT: (0.0, 500.0)}
ANGLES_DEG = (0.0, 45.0, 65.0)
TRUTH_STDERR = 0.001
INTERVALS = {0.68: (0.16, 0.84), 0.95: (0.025, 0.975)}


def make_snow(size, water, soot):
    """Return deep natural snow."""
    return splits.Snow.natural(
        optical_radius_um=size, liquid_water_content=water, impurities_ng_g={"black_carbon": soot}
    )


def sample_truths(random, number):
    """Return true values, shape (number, parameters), with the same water as they share paths."""
    (smallest, largest), (_, most_water), (_, most_soot) = RANGES.values()
    sizes = smallest * (largest / smallest) ** random.random(number)
    water = np.full(number, most_water * random.random() ** 2)
    return np.stack([sizes, water, most_soot * random.random(number) ** 2], axis=1)


def simulate(truths, incidence_deg, seed):
    """Return the spectra of snows and the deviations of their batches, from the same paths."""
    request = SpectralRequest(W, incidence_deg, TRUTH_STDERR, 20_000_000, RunOptions.start(seed))
    spectra = [None] * len(truths)
    media = [make_snow(*map(float, truth)) for truth in truths]
    for group in group_by_shared_paths(media, W):
        results = simulate_spectra(group.path_sharing, request)
        for position, index in zip(group.positions, group.media_indices, strict=True):
            one = results[index]
            spectra[position] = one.reflectance.values, one.reflectance_batches.values
    return spectra


def retrieve_snows(number, n_groups):
    """Return the ranks of true values in their posteriors, shape (snows, parameters)."""
    random, ranks, seconds, warnings = np.random.default_rng(20), [], [], 0
    for group in range(n_groups):
        angle = ANGLES_DEG[group % len(ANGLES_DEG)]
        truths = sample_truths(random, number // n_groups)
        spectra = simulate(truths, angle, 1000 + group)
        for truth, (values, batches) in zip(truths, spectra, strict=True):
            noise = np.hypot(0.01 * values, 0.003)
            measured = values + noise * random.standard_normal(W.size)
            start = time.process_time()
            result = splits.retrieve(
                (W, measured), make_snow(200.0, 0.01, 50.0), RANGES,
                np.diag(noise**2) + batches.T @ batches, fixed={"incidence_deg": angle},
                solver="discrete_ordinates",
            )  # fmt: skip
            seconds.append(time.process_time() - start)
            warnings += any("approximate" in one for one in result.warnings)
            ranks.append((result.dataset.draws.values < truth).mean(axis=0))
    print(f"{np.median(seconds):.2f} s of CPU per retrieval, {warnings} of nonlinear errors")
    return np.array(ranks)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_true_values_are_within_their_intervals():
    number = int(RETRIEVALS or FEW)
    n_groups = 9 if RETRIEVALS else 3
    ranks = retrieve_snows(number, n_groups)
    significance = 1.0 - 0.99 ** (1.0 / (len(INTERVALS) * len(RANGES)))
    failed = []
    for probability, (low, high) in INTERVALS.items():
        inside = ((ranks >= low) & (ranks <= high)).sum(axis=0)
        limits = stats.binom.ppf(
            [0.5 * significance, 1.0 - 0.5 * significance], len(ranks), probability
        )
        for name, count in zip(RANGES, inside, strict=True):
            line = f"{name}: {count / len(ranks):.3f} within {probability:.0%}"
            print(f"{line}, allowed {limits[0] / len(ranks):.3f} to {limits[1] / len(ranks):.3f}")
            if count < limits[0]:
                failed.append(line)
    assert not failed
    # Errors include bounds of those of the model, and so may be too large.
    draw = 0.5 / N_DRAWS
    scores = stats.norm.ppf(ranks.clip(draw, 1.0 - draw))
    for name, score in zip(RANGES, scores.T, strict=True):
        judge_z(score, name, independent=n_groups, bound_added=True)
