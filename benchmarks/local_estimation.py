"""Local estimation against collectors: variance of a radiance factor at equal time.

    python benchmarks/local_estimation.py [--quick]

For layers under smooth faces, the principal plane at the middles of 18 x 72 cells (as many as 5 x 5
degrees would be), one thread: by how much the variance of local estimation is below that of cells
that count rays for as long, median and least over the plane, and whether both agree.
"""

from __future__ import annotations

import argparse

import numpy as np

import splits

CASES = {
    "clear water over sand": {
        "optical_thickness": 1.0, "single_scattering_albedo": 0.8, "asymmetry": 0.9,
        "refractive_index": 1.34, "bottom_albedo": 0.3,
    },
    "paint": {"optical_thickness": 20.0, "single_scattering_albedo": 0.99, "asymmetry": 0.6},
    "cloud": {
        "optical_thickness": 10.0, "single_scattering_albedo": 1.0, "asymmetry": 0.85,
        "refractive_index": 1.0, "bottom_albedo": 0.1,
    },
    "polarizing paint": {
        "optical_thickness": 5.0, "single_scattering_albedo": 0.9, "phase_function": "rayleigh",
        "polarized": True,
    },
}  # fmt: skip
INCIDENCE_DEG = 60.0


def main() -> None:
    """Print one line per case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    rays = 100_000 if parser.parse_args().quick else 2_000_000
    for name, settings in CASES.items():
        layer = splits.ParticleLayer(**settings)
        scene = (layer, [550.0], INCIDENCE_DEG)
        splits.goniophotometer(*scene, rays=1000, estimator="bins", threads=1)
        counted = splits.goniophotometer(*scene, rays=rays, estimator="bins", threads=1)
        plane = {"polar_deg": counted.polar.values, "azimuth_deg": [0.0, 180.0]}
        splits.goniophotometer(*scene, rays=1000, estimator="next_event", threads=1, **plane)
        heard = splits.goniophotometer(
            *scene, rays=rays // 20, estimator="next_event", threads=1, seed=2, **plane
        )
        counted = counted.sel(azimuth=[0.0, 180.0])
        times = [float(ds.attrs["wall_time_s"]) for ds in (counted, heard)]
        gain = counted.brdf_stderr**2 * times[0] / (heard.brdf_stderr**2 * times[1])
        z = (counted.brdf - heard.brdf) / np.hypot(counted.brdf_stderr, heard.brdf_stderr)
        print(
            f"{name}: cells {times[0]:.1f} s, local estimation {times[1]:.1f} s; variance at equal "
            f"time {float(gain.median()):.0f} times below cells, least {float(gain.min()):.0f}; "
            f"difference rms z {float(np.sqrt((z**2).mean())):.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
