"""Time and error of a spectrum of a metre of fine snow, with and without a truncation depth.

Grains of 50 to 100 µm, 300 kg/m³, 200 wavelengths from 400 to 2500 nm, one thread, error 0.002.
`--untruncated` also runs the whole depth, which takes ten minutes.

    python benchmarks/truncation_depth.py [--untruncated] [--max-stderr 0.002] [--saturation 0]
"""

import argparse
import time

import numpy as np
import xarray as xr

import splits
from splits.simulation import deep_medium

WAVELENGTHS_NM = np.linspace(400.0, 2500.0, 200)


def main() -> None:
    """Print times, errors and differences."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--untruncated", action="store_true")
    parser.add_argument("--max-stderr", type=float, default=0.002)
    parser.add_argument("--saturation", type=float, default=0.0)
    arguments = parser.parse_args()
    snow = splits.Snow(
        grain_size_um=(50.0, 100.0),
        density_kg_m3=300.0,
        saturation=arguments.saturation,
        depth_m=1.0,
    )

    def run(seed: int, max_stderr: float) -> tuple[xr.Dataset, float]:
        start = time.process_time()
        ds = splits.spectrophotometer(
            snow, WAVELENGTHS_NM, max_stderr=max_stderr, seed=seed, threads=1
        )
        return ds, time.process_time() - start

    run(0, 0.05)
    truncated, time_s = run(1, arguments.max_stderr)
    depth_m, rays = truncated.attrs["truncation_depth_m"], truncated.attrs["rays"]
    reached = truncated.attrs["max_stderr_reached"]
    print(
        f"truncated at {100.0 * depth_m:.1f} cm: {time_s:.1f} s, {rays} rays, error {reached:.5f}"
    )
    if not arguments.untruncated:
        return
    deep_medium.MIN_DEPTH_MFP = np.inf
    untruncated, untruncated_s = run(2, arguments.max_stderr)
    rays, reached = untruncated.attrs["rays"], untruncated.attrs["max_stderr_reached"]
    print(
        f"untruncated: {untruncated_s:.1f} s, {rays} rays, error {reached:.5f}, "
        f"{untruncated_s / time_s:.0f} × as long"
    )
    for name in ("reflectance", "transmittance"):
        z = (truncated[name] - untruncated[name]) / np.hypot(
            truncated[f"{name}_stderr"], untruncated[f"{name}_stderr"]
        )
        difference = float(np.abs(truncated[name] - untruncated[name]).max())
        print(
            f"{name}: largest difference {difference:.5f}, rms z {float((z**2).mean()) ** 0.5:.2f}"
        )


if __name__ == "__main__":
    main()
