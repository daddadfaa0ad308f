"""Transmittance of deep snow to a relative error, and brute force where that can see it.

Snow of SPLITSnow Table 1, 12 and 50 cm deep, at 500 and 800 nm.  `splits.deep_transmittance` runs
to the relative error; the ordinary spectrophotometer then follows as many rays as are given, and
their difference is printed in units of both errors, unless brute force saw too little for one.

    python benchmarks/deep_transmittance.py [--relative-stderr 0.05] [--rays 2000000]
"""

from __future__ import annotations

import argparse
import math
import time

import splits

DEPTHS_M = (0.12, 0.50)
WAVELENGTHS_NM = (500.0, 800.0)
MIN_TRANSMITTANCE = 5.0
"""Transmittance in errors of its own from which brute force counts as having seen it."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--relative-stderr", type=float, default=0.05)
    parser.add_argument("--rays", type=int, default=2_000_000, help="rays of brute force")
    given = parser.parse_args()
    for depth in DEPTHS_M:
        for wavelength in WAVELENGTHS_NM:
            compare_methods(depth, wavelength, given.relative_stderr, given.rays)


def compare_methods(
    depth_m: float, wavelength_nm: float, relative_stderr: float, rays: int
) -> None:
    """Measure one transmittance both ways and print them."""
    snow = splits.Snow(depth_m=depth_m)
    begun = time.perf_counter()
    deep = splits.deep_transmittance(snow, [wavelength_nm], relative_stderr=relative_stderr)
    spent = time.perf_counter() - begun
    value, error = (float(deep[name][0]) for name in ("transmittance", "transmittance_stderr"))
    print(
        f"{100 * depth_m:g} cm, {wavelength_nm:g} nm: {value:.4g} ± {100 * error / value:.1f} % in "
        f"{spent:.0f} s, rate {float(deep.attenuation_rate[0]):.1f} per m, heaviest family "
        f"{100 * float(deep.largest_history_fraction[0]):.1f} % "
        f"(stopped by {deep.attrs['stop_reason']})",
        flush=True,
    )
    begun = time.perf_counter()
    brute = splits.spectrophotometer(
        snow, [wavelength_nm], max_stderr=1e-6, max_rays=rays, seed=2, kernel="vectorized"
    )
    spent = time.perf_counter() - begun
    plain, its_error = (float(brute[name][0]) for name in ("transmittance", "transmittance_stderr"))
    if plain < MIN_TRANSMITTANCE * its_error:
        print(f"  brute force: nothing to tell after {rays} rays in {spent:.0f} s", flush=True)
        return
    z = (value - plain) / math.hypot(error, its_error)
    print(f"  brute force: {plain:.4g} ± {its_error:.2g} in {spent:.0f} s, z {z:+.2f}", flush=True)


if __name__ == "__main__":
    main()
