"""Expansion against cells: variance in the principal plane at equal time, and the bias.

    python benchmarks/goniophotometer.py [--quick]

For every case both estimators trace one wavelength on one thread. Variances are those stated,
times the seconds spent; the ratio is the cells' over the expansion's, averaged over the principal
plane up to 80 degrees. Cells are 18 × 72 of equal solid angle, as many as 5° × 5° would be. Scatter
is that between seeds. At the end of a line stands how far the mean of all expansions is from the
cells, in units of the error of that difference.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import xarray as xr

import splits
from splits.analysis.directions import select_principal_plane
from splits.instruments.angular_bins import DEFAULT_N_BINS, compute_bin_centres

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
    """Return a dataset and the seconds it took."""
    begun = time.perf_counter()
    dataset = call()
    return dataset, time.perf_counter() - begun


def compute_cost(dataset: xr.Dataset, seconds: float) -> float:
    """Return the mean relative variance in the principal plane, times the seconds."""
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
        # Once for the compiler.
        splits.goniophotometer(*scene, 1, **grid)
        splits.goniophotometer(*scene, 1, estimator="bins", **grid)
        cells, cells_s = time_call(
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
        ratio = compute_cost(cells, cells_s) / compute_cost(runs[0], run_s / repeats)
        mean = np.mean([run.brdf[0].values for run in runs], axis=0)
        stated = np.sqrt(np.sum([run.brdf_stderr[0].values ** 2 for run in runs], axis=0)) / repeats
        scatter = np.std([run.brdf[0].values for run in runs], axis=0, ddof=1)
        one = np.sqrt(np.mean([run.brdf_stderr[0].values ** 2 for run in runs], axis=0))
        low = polar <= MAX_POLAR_DEG
        known = cells.brdf[0].values > 5.0 * cells.brdf_stderr[0].values
        z = (mean - cells.brdf[0].values) / np.hypot(stated, cells.brdf_stderr[0].values)
        z = z[low][known[low]]
        print(
            f"{name}: cells {cells_s:.1f} s, expansion {run_s / repeats:.1f} s to "
            f"{100.0 * error:g} %; variance at equal time {ratio:.0f} times below cells; "
            f"scatter over stated error {(scatter / one)[low].mean():.2f}; "
            f"against cells rms z {np.sqrt((z**2).mean()):.2f}; "
            f"least BRDF {min(float(run.brdf.min()) for run in runs):.3g}",
            flush=True,
        )


if __name__ == "__main__":
    main()
