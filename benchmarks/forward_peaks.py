"""Local (next-event) estimation for peaked phase functions, with and without a separate peak.

    python benchmarks/forward_peaks.py [--quick]

For non-absorbing layers with light from the zenith, on one thread, with 24 seeds for each method:
medians relative to the mean with a separate peak, rms z about that mean, scatter, processor time
per ray, and the factor by which the variance at equal time is lower with a separate peak.
"""

import argparse
import math
import time
from pathlib import Path

import numpy as np
import pandas as pd

import splits
from splits.kernels import phase_function

PHASE_TABLE = Path(__file__).parents[1] / "tests" / "physics" / "reference" / "cloud_c1.csv"
CASES = {
    "thin cloud C.1": ({}, 4.0, 20_000),
    "Henyey-Greenstein, g = 0.95": ({"asymmetry": 0.95}, 8.0, 20_000),
    "Henyey-Greenstein, g = 0.99": ({"asymmetry": 0.99}, 8.0, 10_000),
    "cloud C.1": ({}, 64.0, 20_000),
}
POLAR_DEG = [30.0, 60.0, 82.0, 87.0]
SEEDS = 24


def make_cloud_phase_function() -> dict[str, list[float]]:
    """Return the phase function of cloud C.1."""
    table = pd.read_csv(PHASE_TABLE, comment="#").sort_values("angle_deg", ascending=False)
    cosine = np.cos(np.radians(table.angle_deg.to_numpy()))
    cosine[[0, -1]] = -1.0, 1.0
    return {"cosine": cosine.tolist(), "density": table.density_per_sr.tolist()}


def measure_layer(
    layer: splits.ParticleLayer, rays: int, seeds: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return BRDF and BTDF of all seeds, their errors, and the time per ray (s)."""
    settings = {
        "polar_deg": POLAR_DEG,
        "azimuth_deg": [0.0],
        "estimator": "next_event",
        "threads": 1,
    }
    splits.goniophotometer(layer, [700.0], 0.0, 10, **settings)
    start = time.process_time()
    runs = [
        splits.goniophotometer(layer, [700.0], 0.0, rays, seed, **settings) for seed in range(seeds)
    ]
    time_per_ray_s = (time.process_time() - start) / (rays * seeds)
    value, stderr = (
        np.array([[run[name + end].values.ravel() for name in ("brdf", "btdf")] for run in runs])
        for end in ("", "_stderr")
    )
    return value, stderr, time_per_ray_s


def main() -> None:
    """Print the results of each case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    np.set_printoptions(precision=2, suppress=True)
    for name, (phase, thickness, rays) in CASES.items():
        layer = splits.ParticleLayer(
            optical_thickness=thickness, single_scattering_albedo=1.0, refractive_index=1.0,
            bottom_albedo=None, **(phase or {"phase_function": make_cloud_phase_function()}),
        )  # fmt: skip
        results = []
        for threshold in (math.inf, 20.0):
            phase_function.PEAK_THRESHOLD_PER_SR = threshold
            results.append(measure_layer(layer, rays // 10 if quick else rays, SEEDS))
        mean = results[1][0].mean(axis=0)
        gain = (
            (results[0][0].std(axis=0) / results[1][0].std(axis=0)) ** 2
            * results[0][2]
            / results[1][2]
        )
        for label, (value, stderr, time_per_ray_s) in zip(
            ("not separate", "separate"), results, strict=True
        ):
            z = np.sqrt((((value - mean) / stderr) ** 2).mean(axis=0))
            print(f"{name}, peak {label}: {1e6 * time_per_ray_s:.0f} µs per ray")
            for side, rows in enumerate(("BRDF", "BTDF")):
                print(
                    f"  {rows} at {POLAR_DEG}: "
                    f"median {np.median(value, axis=0)[side] / mean[side]}, "
                    f"rms z {z[side]}, scatter {value.std(axis=0)[side] / mean[side]}"
                )
        print(f"  variance at equal time lower by {gain.ravel()}", flush=True)


if __name__ == "__main__":
    main()
