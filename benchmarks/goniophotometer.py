"""Expansion compared with angular bins: variance in the principal plane at equal time, and bias.

    python benchmarks/goniophotometer.py [--quick]

For every case both estimators trace one wavelength on one thread.  The printed ratio is the stated
variance times the computing time of bins over that of the expansion, averaged over the principal
plane up to 80 degrees.  There are 18 × 72 bins of equal solid angle, as many as bins of 5° × 5°.
Scatter is that between seeds.  The rms z is the difference between the mean of all expansions and
the bins, in units of its standard error.
"""

import argparse
import time

import numpy as np
import xarray as xr

import splits
from splits.analysis.directions import select_principal_plane
from splits.instruments.angular_tallies import DEFAULT_N_BINS, compute_bin_centres

MAX_POLAR_DEG = 80.0
TABLE1 = splits.Snow()
CASES = {
    "snow, 600 nm, 0 degrees": (TABLE1, 600.0, 0.0),
    "snow, 600 nm, 60 degrees": (TABLE1, 600.0, 60.0),
    "snow, 1800 nm, 69.3 degrees": (splits.Snow(depth_m=0.25), 1800.0, 69.3),
    "snow, 600 nm, 84.8 degrees": (splits.Snow(depth_m=0.25), 600.0, 84.8),
    "sand, 600 nm, 60 degrees": (splits.Sand(), 600.0, 60.0),
}


def time_call(call):
    """Return the dataset of a call and its time (s)."""
    start = time.perf_counter()
    dataset = call()
    return dataset, time.perf_counter() - start


def compute_cost(dataset: xr.Dataset, seconds: float) -> float:
    """Return the mean relative variance in the principal plane, times the time."""
    plane = select_principal_plane(dataset).isel(wavelength=0)
    plane = plane.isel(angle=np.abs(plane.angle.values) <= MAX_POLAR_DEG)
    mean = float(plane.brdf.mean())
    return seconds * float((plane.brdf_stderr**2).mean()) / mean**2


def main() -> None:
    """Print one line per case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer rays and repeats")
    quick = parser.parse_args().quick
    rays, error, repeats = (100_000, 0.05, 3) if quick else (1_000_000, 0.02, 8)
    polar, azimuth = compute_bin_centres(DEFAULT_N_BINS)
    for name, (medium, wavelength, incidence) in CASES.items():
        scene = (medium, [wavelength], incidence)
        grid = {"polar_deg": polar, "azimuth_deg": azimuth, "threads": 1}
        # The first calls compile.
        splits.goniophotometer(*scene, 1, **grid)
        splits.goniophotometer(*scene, 1, estimator="bins", **grid)
        bins, bins_s = time_call(
            lambda scene=scene: splits.goniophotometer(
                *scene, rays, estimator="bins", n_bins=DEFAULT_N_BINS, threads=1
            )
        )
        runs, run_s = time_call(
            lambda scene=scene, grid=grid: [
                splits.goniophotometer(*scene, seed=seed, relative_stderr=error, **grid)
                for seed in range(repeats)
            ]
        )
        ratio = compute_cost(bins, bins_s) / compute_cost(runs[0], run_s / repeats)
        mean = np.mean([run.brdf[0].values for run in runs], axis=0)
        stated = np.sqrt(np.sum([run.brdf_stderr[0].values ** 2 for run in runs], axis=0)) / repeats
        scatter = np.std([run.brdf[0].values for run in runs], axis=0, ddof=1)
        stated_once = np.sqrt(np.mean([run.brdf_stderr[0].values ** 2 for run in runs], axis=0))
        low = polar <= MAX_POLAR_DEG
        significant = bins.brdf[0].values > 5.0 * bins.brdf_stderr[0].values
        z = (mean - bins.brdf[0].values) / np.hypot(stated, bins.brdf_stderr[0].values)
        z = z[low][significant[low]]
        print(
            f"{name}: bins {bins_s:.1f} s, expansion {run_s / repeats:.1f} s to "
            f"{100.0 * error:g} %; variance at equal time {ratio:.0f} times below bins; "
            f"scatter over stated error {(scatter / stated_once)[low].mean():.2f}; "
            f"against bins rms z {np.sqrt((z**2).mean()):.2f}; "
            f"smallest BRDF {min(float(run.brdf.min()) for run in runs):.3g}",
            flush=True,
        )


if __name__ == "__main__":
    main()
