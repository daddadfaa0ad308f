"""Digests of default results, to test whether a change of the code changes a number.

    python benchmarks/digests.py

Each line has the name of a run with fixed seed, the SHA-256 of its values (variables sorted
by name, without rounding), and a mean for orientation.  Run it at two commits on one machine and
compare the lines: equal digests mean bit-identical values.  Vector units of different width may
round differently, so digests from different machines are not comparable.
"""

import hashlib
from collections.abc import Callable

import numpy as np
import xarray as xr

import splits

BANDS_NM = [450.0, 700.0, 1030.0, 1300.0]
CLOUD = splits.ParticleLayer(optical_thickness=4.0, single_scattering_albedo=0.95, asymmetry=0.8)
NATURAL_SNOW = splits.Snow.natural(specific_surface_area_m2_kg=20.0, depth_m=0.1)
RUNS: dict[str, Callable[[], xr.Dataset]] = {
    "snow": lambda: splits.spectrophotometer(splits.Snow(), BANDS_NM, 30.0, max_stderr=0.005),
    "snow, diffuse": lambda: splits.spectrophotometer(
        splits.Snow(), BANDS_NM, "diffuse", max_stderr=0.005
    ),
    "snow, splits_2007": lambda: splits.spectrophotometer(
        splits.Snow(interpretation="splits_2007"), BANDS_NM, 60.0, max_stderr=0.005
    ),
    "snow, geometric": lambda: splits.spectrophotometer(
        splits.Snow(interpretation="geometric"), BANDS_NM, 60.0, max_stderr=0.005
    ),
    "snow, BRDF": lambda: splits.goniophotometer(
        splits.Snow(), [600.0], 30.0, relative_stderr=0.05, azimuth_deg=[0.0, 180.0]
    ),
    "snow, single scattering": lambda: splits.single_scattering(
        splits.Snow(), BANDS_NM, moments=8, rays=20_000
    ),
    "snow, lateral spread": lambda: splits.beam_spread(splits.Snow(), [900.0], 0.0),
    "sand": lambda: splits.spectrophotometer(splits.Sand(), BANDS_NM[:3], 0.0, max_stderr=0.005),
    "layer": lambda: splits.spectrophotometer(CLOUD, [600.0], 30.0, max_stderr=0.003),
    "stack over ground": lambda: splits.spectrophotometer(
        splits.Stack([splits.Snow(depth_m=0.02), splits.Snow(depth_m=0.05, density_kg_m3=350.0)],
                     ground=0.2), BANDS_NM, 30.0, max_stderr=0.005
    ),
    "natural snow": lambda: splits.spectrophotometer(
        NATURAL_SNOW, BANDS_NM, 60.0, max_stderr=0.005, solver="monte_carlo"
    ),
    "natural snow, geometric": lambda: splits.spectrophotometer(
        splits.Snow.natural(
            specific_surface_area_m2_kg=20.0, depth_m=0.1, interpretation="geometric"
        ),
        BANDS_NM, 60.0, max_stderr=0.005,
    ),
}  # fmt: skip


def compute_digest(dataset: xr.Dataset) -> str:
    """Return the SHA-256 of all values of a dataset, with variables sorted by name."""
    total = hashlib.sha256()
    for name in sorted(str(variable) for variable in dataset.data_vars):
        total.update(name.encode())
        total.update(np.ascontiguousarray(dataset[name].values).tobytes())
    return total.hexdigest()


def main() -> None:
    """Print a line for each run."""
    for name, run in RUNS.items():
        dataset = run()
        first = next(iter(dataset.data_vars))
        mean = float(np.nanmean(dataset[first].values))
        print(f"{name:28s} {compute_digest(dataset)[:16]} {first} {mean:.9g}", flush=True)


if __name__ == "__main__":
    main()
