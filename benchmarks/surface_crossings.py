"""A hundred million crossings of rough surfaces: do rays leak or get lost, and how long they take.

    python benchmarks/surface_crossings.py [--quick]

Every ray has a surface of its own and is reflected and refracted there until it leaves upwards
(`splits.kernels.particle_layer.leak_census`).  Prints, for every surface: crossings; points of legs
found on the wrong side of the surface; rays lost; evaluations of the surface, and time on one
thread, per crossing.  Then time per wave of an evaluation, and per crossing, of realizations that
are already drawn.
"""

from __future__ import annotations

import argparse
import math
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from splits.kernels.math.vectors import Vector
from splits.kernels.particle_layer.leak_census import (
    EVALUATIONS,
    INTERSECTIONS,
    LEAKS,
    LOST_RAYS,
    count_leaks,
)
from splits.kernels.rough_surface.intersection import find_first_intersection
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
# Surface, refractive index, angle of incidence, share of the crossings.
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
    """Return counts of at least so many crossings, and the seconds they took."""
    fields = RoughSurface.from_input(surface).make_height_fields()

    def batch(number: int) -> np.ndarray:
        return count_leaks(1, number * RAYS_PER_BATCH, RAYS_PER_BATCH, fields, index, mu).counts

    total, done, begun = np.zeros(5, dtype=np.int64), 0, time.perf_counter()
    while total[INTERSECTIONS] < min_crossings:
        # As many batches as are likely to be missing, so that threads rarely wait.
        per_batch = total[INTERSECTIONS] / done if done else 3.0 * RAYS_PER_BATCH
        more = THREADS * math.ceil((min_crossings - total[INTERSECTIONS]) / per_batch / THREADS)
        total += sum(pool.map(batch, range(done, done + more)))
        done += more
    return total, time.perf_counter() - begun


def time_waves() -> None:
    """Print what an evaluation and a crossing take in realizations that are there."""
    x, y = np.random.default_rng(1).uniform(-50.0, 50.0, (2, 2000))
    for waves_per_surface in (16, 64, 600):
        surface = RoughSurface(GAUSSIAN | {"rms_height_m": 0.5, "waves": waves_per_surface})
        drawn = make_realization(surface.sample_realization(1))
        places = [Vector(x[i], y[i], drawn.max_height) for i in range(200)]
        d = Vector(0.6, 0.0, -0.8)
        evaluation = crossing = math.inf
        for _ in range(20):
            begun = time.perf_counter()
            compute_heights_and_slopes(drawn.waves, x, y)
            evaluation = min(evaluation, time.perf_counter() - begun)
            begun = time.perf_counter()
            for place in places:
                find_first_intersection(drawn, place, d, 1.0)
            crossing = min(crossing, time.perf_counter() - begun)
        per_wave = evaluation / x.size / waves_per_surface
        per_crossing = crossing / len(places)
        print(
            f"{waves_per_surface} waves: {1e9 * per_wave:.2f} ns per wave, "
            f"{1e6 * per_crossing:.1f} µs per crossing from above"
        )


def main() -> None:
    """Print one line per surface."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a million crossings")
    wanted = 1e6 if parser.parse_args().quick else 1e8
    total, seconds = np.zeros(5, dtype=np.int64), 0.0
    with ThreadPoolExecutor(THREADS) as pool:
        count_crossings(pool, GAUSSIAN | {"rms_height_m": 0.1}, 1.34, 1.0, 1)
        for name, (surface, index, angle, share) in CASES.items():
            mu = math.cos(math.radians(angle))
            counts, took = count_crossings(pool, surface, index, mu, share * wanted)
            total += counts
            seconds += took
            print(
                f"{name}: {counts[INTERSECTIONS]} crossings, {counts[LEAKS]} leaks, "
                f"{counts[LOST_RAYS]} lost, "
                f"{counts[EVALUATIONS] / counts[INTERSECTIONS]:.1f} evaluations "
                f"and {1e6 * THREADS * took / counts[INTERSECTIONS]:.2f} µs per crossing",
                flush=True,
            )
    print(
        f"all: {total[INTERSECTIONS]} crossings, {total[LEAKS]} leaks, {total[LOST_RAYS]} lost, "
        f"{seconds:.0f} s on {THREADS} threads"
    )
    time_waves()


if __name__ == "__main__":
    main()
