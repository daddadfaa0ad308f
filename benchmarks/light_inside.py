"""What planes cost: `splits.profile` against the plain spectrum of the same sample.

Wet snow of SPLITSnow Table 1 at 211 wavelengths, one thread, by turns.  Printed are seconds of CPU
times the mean square error of reflectance, over that of the spectrophotometer: how much longer it
takes to know reflectance as well, with so many planes listened to besides.

    python benchmarks/light_inside.py [--planes 10 50] [--rounds 3] [--max-stderr 0.004]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import xarray as xr

import splits

WAVELENGTHS = np.arange(400.0, 2501.0, 10.0)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--planes", type=int, nargs="+", default=[10, 50])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--max-stderr", type=float, default=0.004)
    given = parser.parse_args()
    snow = splits.Snow()

    def plain(seed: int) -> xr.Dataset:
        return splits.spectrophotometer(
            snow, WAVELENGTHS, max_stderr=given.max_stderr, seed=seed, threads=1
        )

    def inside(planes: int) -> Callable[[int], xr.Dataset]:
        depths = snow.depth_m * np.arange(1, planes + 1) / (planes + 1)
        return lambda seed: splits.profile(
            snow, WAVELENGTHS, depths, max_stderr=given.max_stderr, seed=seed, threads=1
        )

    runs = {"plain": plain, **{f"{n} planes": inside(n) for n in given.planes}}
    for run in runs.values():
        run(0)
    costs: dict[str, list[float]] = {name: [] for name in runs}
    for seed in range(1, given.rounds + 1):
        for name, run in runs.items():
            begun = time.process_time()
            ds = run(seed)
            spent = time.process_time() - begun
            if name == "plain":
                square = float((ds.reflectance_stderr**2).mean())
            else:
                square = float((ds.upward_irradiance_stderr[:, 0] ** 2).mean())
            costs[name].append(spent * square)
            print(f"{name}: {spent:.1f} s, {ds.attrs['rays']} rays, rms error {square**0.5:.2g}")
    for name, cost in costs.items():
        ratios = np.array(cost) / np.array(costs["plain"])
        print(f"{name}: {np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f})")


if __name__ == "__main__":
    main()
