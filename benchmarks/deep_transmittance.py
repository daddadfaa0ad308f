"""Transmittance of deep snow by splitting and roulette, compared with plain Monte Carlo.

Snow of SPLITSnow Table 1, 12 and 50 cm deep, at 500 and 800 nm.  `splits.deep_transmittance` runs
to the relative error; the spectrophotometer then traces a given number of rays.  The difference is
printed in units of the combined error, if plain Monte Carlo resolves the transmittance.

    python benchmarks/deep_transmittance.py [--relative-stderr 0.05] [--rays 2000000]
"""

from __future__ import annotations

import argparse
import math
import time

import splits

DEPTHS_M = (0.12, 0.50)
WAVELENGTHS_NM = (500.0, 800.0)
MIN_SIGNAL_SIGMA = 5.0
"""Ratio to its error above which the transmittance by plain Monte Carlo is resolved."""


def main() -> None:
    """Print all comparisons."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--relative-stderr", type=float, default=0.05)
    parser.add_argument("--rays", type=int, default=2_000_000, help="rays of plain Monte Carlo")
    arguments = parser.parse_args()
    for depth in DEPTHS_M:
        for wavelength in WAVELENGTHS_NM:
            compare_methods(depth, wavelength, arguments.relative_stderr, arguments.rays)


def compare_methods(
    depth_m: float, wavelength_nm: float, relative_stderr: float, rays: int
) -> None:
    """Compute one transmittance with both methods and print them."""
    snow = splits.Snow(depth_m=depth_m)
    start = time.perf_counter()
    deep = splits.deep_transmittance(snow, [wavelength_nm], relative_stderr=relative_stderr)
    time_s = time.perf_counter() - start
    value, error = (float(deep[name][0]) for name in ("transmittance", "transmittance_stderr"))
    print(
        f"{100 * depth_m:g} cm, {wavelength_nm:g} nm: {value:.4g} ± {100 * error / value:.1f} % in "
        f"{time_s:.0f} s, rate {float(deep.attenuation_rate[0]):.1f} per m, "
        f"largest history fraction {100 * float(deep.largest_history_fraction[0]):.1f} % "
        f"(stopped by {deep.attrs['stop_reason']})",
        flush=True,
    )
    start = time.perf_counter()
    plain_result = splits.spectrophotometer(
        snow, [wavelength_nm], max_stderr=1e-6, max_rays=rays, seed=2, kernel="vectorized"
    )
    time_s = time.perf_counter() - start
    plain, plain_error = (
        float(plain_result[name][0]) for name in ("transmittance", "transmittance_stderr")
    )
    if plain < MIN_SIGNAL_SIGMA * plain_error:
        print(f"  plain Monte Carlo: unresolved after {rays} rays in {time_s:.0f} s", flush=True)
        return
    z = (value - plain) / math.hypot(error, plain_error)
    print(
        f"  plain Monte Carlo: {plain:.4g} ± {plain_error:.2g} in {time_s:.0f} s, z {z:+.2f}",
        flush=True,
    )


if __name__ == "__main__":
    main()
