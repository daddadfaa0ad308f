"""How much sooner the spectral estimator reaches an error than the papers' algorithm.

Both measure 211-wavelength spectra to the same largest standard error in this one run, on one
thread, after a warm-up that compiles the kernels.  The analog estimator is timed at every tenth
wavelength and scaled to all of them, in two ways:

uniform   the same number of rays at every wavelength, as many as the noisiest one needs: our
          reading of the papers, which do not say how rays are shared among wavelengths;
adaptive  every wavelength stops by itself as soon as it has reached the error.

    python benchmarks/speed_against_error.py [TABLE.csv]
"""

from __future__ import annotations

import sys

import numpy as np
import pandas as pd

import splits

WAVELENGTHS = np.arange(400, 2501, 10)
MEDIA = {
    "representative (Table 1)": splits.Snow(),
    "thin, fine, dry": splits.Snow(depth_m=0.02, grain_size_um=(100, 200), saturation=0),
}
STDERR = 0.002


def seconds(medium: splits.Snow, estimator: str, wavelengths: np.ndarray) -> tuple[float, int]:
    """Return the time an estimator takes to reach `STDERR` on one thread, and its rays."""
    dataset = splits.spectrophotometer(
        medium, wavelengths, max_stderr=STDERR, estimator=estimator, threads=1, seed=3
    )
    if dataset.attrs["stopped_by"] != "error":
        raise RuntimeError(f"{estimator} did not reach {STDERR}")
    return dataset.attrs["wall_time_s"], dataset.attrs["rays"]


def main() -> None:
    """Measure and print the table, and write it if a path is given."""
    rows = []
    for name, medium in MEDIA.items():
        for estimator in ("spectral", "analog"):
            splits.spectrophotometer(medium, [500, 1500], max_stderr=0.2, estimator=estimator)
        spectral, rays = seconds(medium, "spectral", WAVELENGTHS)
        single = [seconds(medium, "analog", [w]) for w in WAVELENGTHS[::10]]
        scale = WAVELENGTHS.size / len(single)
        adaptive = scale * sum(time for time, _ in single)
        most = max(n for _, n in single)
        uniform = scale * sum(time * most / n for time, n in single)
        rows.append(
            {
                "medium": name,
                "max_stderr": STDERR,
                "spectral_s": spectral,
                "spectral_rays": rays,
                "uniform_s": uniform,
                "uniform_ratio": uniform / spectral,
                "adaptive_s": adaptive,
                "adaptive_ratio": adaptive / spectral,
            }
        )
        print(
            f"{name}, error {STDERR:g}: spectral {spectral:.1f} s ({rays} rays); analog uniform "
            f"{uniform:.0f} s, ratio {uniform / spectral:.0f}; analog adaptive {adaptive:.0f} s, "
            f"ratio {adaptive / spectral:.0f}",
            flush=True,
        )
    if len(sys.argv) > 1:
        pd.DataFrame(rows).to_csv(sys.argv[1], index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
