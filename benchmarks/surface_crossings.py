"""Leaked and lost rays, and time, of a hundred million crossings of rough surfaces.

    python benchmarks/surface_crossings.py [--quick]

Every ray has its own realization of the surface, and is reflected and refracted there until it
leaves upwards (`splits.kernels.rough_surface.missed_intersections`).  Prints, for every surface:
crossings; points of segments on the wrong side of the surface; lost rays; evaluations of the
surface, and time on one thread, per crossing.  Then, for given realizations, the time per wave of
an evaluation, and per crossing.
"""

from __future__ import annotations

import argparse
import math
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from splits.kernels.arithmetic import Vector
from splits.kernels.rough_surface.intersection import find_first_intersection
from splits.kernels.rough_surface.missed_intersections import (
    EVALUATIONS,
    INTERSECTIONS,
    LEAKS,
    LOST_RAYS,
    count_leaks,
)
from splits.kernels.rough_surface.realization import compute_heights_and_slopes, make_realization
from splits.media.rough_surface import RoughSurface

THREADS = 2
RAYS_PER_BATCH = 2_000
GAUSSIAN = {"wave_number_per_m": 1.0, "correlation": "gaussian", "waves": 16}
TABULATED_SPECTRUM = {"correlation": "exponential_printed"}
PAIR = [
    TABULATED_SPECTRUM | {"rms_height_m": 11.25, "wave_number_per_m": 0.025, "waves": 500},
    TABULATED_SPECTRUM | {"rms_height_m": 0.2, "wave_number_per_m": 3.0, "waves": 100},
]
SMALL_PAIR = [field | {"waves": waves} for field, waves in zip(PAIR, (20, 12), strict=True)]
EXPONENTIAL = {"rms_height_m": 0.1, "wave_number_per_m": 1.0, "waves": 32, "band_limit_per_m": 100}
# Surface, refractive index, angle of incidence, fraction of the crossings.
CASES = {
    "water, rms slope 0.2": (GAUSSIAN | {"rms_height_m": 0.1}, 1.34, 40.0, 0.3),
    "water, rms slope 0.2, grazing": (GAUSSIAN | {"rms_height_m": 0.1}, 1.34, 89.9, 0.1),
    "glass, rms slope 2": (GAUSSIAN | {"rms_height_m": 1.0}, 1.52, 40.0, 0.3),
    "glass, rms slope 2, grazing": (GAUSSIAN | {"rms_height_m": 1.0}, 1.52, 89.9, 0.05),
    "glass, exponential, rms slope 1": (EXPONENTIAL, 1.52, 40.0, 0.15),
    "glass, two scales": (SMALL_PAIR, 1.5, 40.0, 0.098),
    "glass, two scales, 600 waves": (PAIR, 1.5, 40.0, 0.002),
}


def count_crossings(
    pool: ThreadPoolExecutor, surface: object, index: float, mu: float, min_crossings: float
):
    """Return the counts of at least `min_crossings` crossings, and the time (s)."""
    fields = RoughSurface.from_input(surface).make_height_fields()

    def batch(number: int) -> np.ndarray:
        return count_leaks(1, number * RAYS_PER_BATCH, RAYS_PER_BATCH, fields, index, mu).counts

    total, n_done, start = np.zeros(5, dtype=np.int64), 0, time.perf_counter()
    while total[INTERSECTIONS] < min_crossings:
        # The expected number of missing batches, so that threads rarely wait.
        per_batch = total[INTERSECTIONS] / n_done if n_done else 3.0 * RAYS_PER_BATCH
        n_missing = THREADS * math.ceil(
            (min_crossings - total[INTERSECTIONS]) / per_batch / THREADS
        )
        total += sum(pool.map(batch, range(n_done, n_done + n_missing)))
        n_done += n_missing
    return total, time.perf_counter() - start


def time_waves() -> None:
    """Print the times of an evaluation and of a crossing for given realizations."""
    x, y = np.random.default_rng(1).uniform(-50.0, 50.0, (2, 2000))
    for waves_per_surface in (16, 64, 600):
        surface = RoughSurface(GAUSSIAN | {"rms_height_m": 0.5, "waves": waves_per_surface})
        realization = make_realization(surface.sample_realization(1))
        positions = [Vector(x[i], y[i], realization.max_height) for i in range(200)]
        d = Vector(0.6, 0.0, -0.8)
        evaluation = crossing = math.inf
        for _ in range(20):
            start = time.perf_counter()
            compute_heights_and_slopes(realization.waves, x, y)
            evaluation = min(evaluation, time.perf_counter() - start)
            start = time.perf_counter()
            for position in positions:
                find_first_intersection(realization, position, d, 1.0)
            crossing = min(crossing, time.perf_counter() - start)
        per_wave = evaluation / x.size / waves_per_surface
        per_crossing = crossing / len(positions)
        print(
            f"{waves_per_surface} waves: {1e9 * per_wave:.2f} ns per wave, "
            f"{1e6 * per_crossing:.1f} µs per crossing from above"
        )


def main() -> None:
    """Print one line per surface."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a million crossings")
    n_crossings = 1e6 if parser.parse_args().quick else 1e8
    total, seconds = np.zeros(5, dtype=np.int64), 0.0
    with ThreadPoolExecutor(THREADS) as pool:
        count_crossings(pool, GAUSSIAN | {"rms_height_m": 0.1}, 1.34, 1.0, 1)
        for name, (surface, index, angle, fraction) in CASES.items():
            mu = math.cos(math.radians(angle))
            counts, time_s = count_crossings(pool, surface, index, mu, fraction * n_crossings)
            total += counts
            seconds += time_s
            print(
                f"{name}: {counts[INTERSECTIONS]} crossings, {counts[LEAKS]} leaks, "
                f"{counts[LOST_RAYS]} lost, "
                f"{counts[EVALUATIONS] / counts[INTERSECTIONS]:.1f} evaluations "
                f"and {1e6 * THREADS * time_s / counts[INTERSECTIONS]:.2f} µs per crossing",
                flush=True,
            )
    print(
        f"all: {total[INTERSECTIONS]} crossings, {total[LEAKS]} leaks, {total[LOST_RAYS]} lost, "
        f"{seconds:.0f} s on {THREADS} threads"
    )
    time_waves()


if __name__ == "__main__":
    main()
