"""Local (next-event) estimation compared with angular bins: variance at equal time.

    python benchmarks/local_estimation.py [--quick]

For layers with smooth boundaries, in the principal plane at the centres of 18 x 72 bins (as many as
bins of 5 x 5 degrees), on one thread: the factor by which the variance of local estimation is below
that of bins at equal time, its median and minimum over the plane, and the rms z of the difference.
"""

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
        arguments = (layer, [550.0], INCIDENCE_DEG)
        splits.goniophotometer(*arguments, rays=1000, estimator="bins", threads=1)
        bins = splits.goniophotometer(*arguments, rays=rays, estimator="bins", threads=1)
        plane = {"polar_deg": bins.polar.values, "azimuth_deg": [0.0, 180.0]}
        splits.goniophotometer(*arguments, rays=1000, estimator="next_event", threads=1, **plane)
        estimate = splits.goniophotometer(
            *arguments, rays=rays // 20, estimator="next_event", threads=1, seed=2, **plane
        )
        bins = bins.sel(azimuth=[0.0, 180.0])
        times = [float(ds.attrs["wall_time_s"]) for ds in (bins, estimate)]
        gain = bins.brdf_stderr**2 * times[0] / (estimate.brdf_stderr**2 * times[1])
        z = (bins.brdf - estimate.brdf) / np.hypot(bins.brdf_stderr, estimate.brdf_stderr)
        print(
            f"{name}: bins {times[0]:.1f} s, local estimation {times[1]:.1f} s; variance at equal "
            f"time {float(gain.median()):.0f} times below bins, smallest {float(gain.min()):.0f}; "
            f"difference rms z {float(np.sqrt((z**2).mean())):.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
