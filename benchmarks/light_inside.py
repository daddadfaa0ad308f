"""What planes cost: `splits.profile` against the plain spectrum, for the same rays.

Wet snow of SPLITSnow Table 1 at 211 wavelengths, one thread, by turns.  The first round of either
instrument gives as many rays to weak as to strong absorption; so large an error is asked for that
there is no second.  Printed are CPU seconds per ray over those of the spectrophotometer: how much
longer it takes to listen at so many planes.  To know the light inside as well as the reflectance
takes more rays besides, which depends on the depths.

    python benchmarks/light_inside.py [--planes 10 50] [--rounds 20]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import xarray as xr

import splits

WAVELENGTHS = np.arange(400.0, 2501.0, 10.0)
ONE_ROUND = 0.5


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--planes", type=int, nargs="+", default=[10, 50])
    parser.add_argument("--rounds", type=int, default=20)
    given = parser.parse_args()
    snow = splits.Snow()

    def plain(seed: int) -> xr.Dataset:
        return splits.spectrophotometer(
            snow, WAVELENGTHS, max_stderr=ONE_ROUND, seed=seed, threads=1
        )

    def inside(planes: int) -> Callable[[int], xr.Dataset]:
        depths = snow.depth_m * np.arange(1, planes + 1) / (planes + 1)
        return lambda seed: splits.profile(
            snow, WAVELENGTHS, depths, max_stderr=ONE_ROUND, seed=seed, threads=1
        )

    runs = {"plain": plain, **{f"{n} planes": inside(n) for n in given.planes}}
    for run in runs.values():
        run(0)
    seconds, rays = (dict.fromkeys(runs, 0.0) for _ in range(2))
    for seed in range(1, given.rounds + 1):
        for name, run in runs.items():
            begun = time.process_time()
            rays[name] += run(seed).attrs["rays"]
            seconds[name] += time.process_time() - begun
    base = seconds["plain"] / rays["plain"]
    for name, spent in seconds.items():
        each = spent / rays[name]
        print(f"{name}: {1e6 * each:.1f} µs per ray, {each / base:.2f} times the plain spectrum")


if __name__ == "__main__":
    main()
