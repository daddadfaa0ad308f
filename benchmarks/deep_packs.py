"""A metre of fine snow: time and error with the cut, and without it.

Grains of 50 to 100 µm, 300 kg/m³, 200 wavelengths from 400 to 2500 nm, one thread, error 0.002.
Without the cut that takes ten minutes; `--whole` measures it, too.

    python benchmarks/deep_packs.py [--whole] [--max-stderr 0.002] [--saturation 0]
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import xarray as xr

import splits
from splits.simulation import deep_medium

WAVELENGTHS_NM = np.linspace(400.0, 2500.0, 200)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--whole", action="store_true")
    parser.add_argument("--max-stderr", type=float, default=0.002)
    parser.add_argument("--saturation", type=float, default=0.0)
    given = parser.parse_args()
    snow = splits.Snow(
        grain_size_um=(50.0, 100.0), density_kg_m3=300.0, saturation=given.saturation, depth_m=1.0
    )

    def run(seed: int, max_stderr: float) -> tuple[xr.Dataset, float]:
        begun = time.process_time()
        ds = splits.spectrophotometer(
            snow, WAVELENGTHS_NM, max_stderr=max_stderr, seed=seed, threads=1
        )
        return ds, time.process_time() - begun

    run(0, 0.05)
    cut, spent = run(1, given.max_stderr)
    traced, rays = cut.attrs["truncation_depth_m"], cut.attrs["rays"]
    reached = cut.attrs["max_stderr_reached"]
    print(f"cut at {100.0 * traced:.1f} cm: {spent:.1f} s, {rays} rays, error {reached:.5f}")
    if not given.whole:
        return
    deep_medium.MIN_DEPTH_MFP = np.inf
    whole, longer = run(2, given.max_stderr)
    rays, reached = whole.attrs["rays"], whole.attrs["max_stderr_reached"]
    print(
        f"whole: {longer:.1f} s, {rays} rays, error {reached:.5f}, {longer / spent:.0f} × as long"
    )
    for name in ("reflectance", "transmittance"):
        z = (cut[name] - whole[name]) / np.hypot(cut[f"{name}_stderr"], whole[f"{name}_stderr"])
        off = float(np.abs(cut[name] - whole[name]).max())
        print(f"{name}: largest difference {off:.5f}, rms z {float((z**2).mean()) ** 0.5:.2f}")


if __name__ == "__main__":
    main()
