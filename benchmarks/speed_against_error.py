"""How much sooner the spectral estimator reaches an error than the papers' algorithm.

Both measure the 211-wavelength spectrum of the representative sample (SPLITSnow Table 1) in this
one run, on one thread.  The analog estimator is timed at every tenth wavelength and scaled to
all of them; both are timed at the same error, after a warm-up that compiles the kernels.

    python benchmarks/speed_against_error.py [TABLE.csv]
"""

from __future__ import annotations

import sys
import time

import numpy as np
import pandas as pd

import splits

WAVELENGTHS = np.arange(400, 2501, 10)
MEDIA = {
    "representative (Table 1)": splits.Snow(),
    "thin, fine, dry": splits.Snow(depth_m=0.02, grain_size_um=(100, 200), saturation=0),
}
STDERR = 0.002


def seconds(medium: splits.Snow, estimator: str, wavelengths: np.ndarray) -> float:
    """Return the time that an estimator takes to reach `STDERR` on one thread."""
    begun = time.perf_counter()
    dataset = splits.spectrophotometer(
        medium, wavelengths, max_stderr=STDERR, estimator=estimator, threads=1, seed=3
    )
    if dataset.attrs["stopped_by"] != "error":
        raise RuntimeError(f"{estimator} did not reach {STDERR}")
    return time.perf_counter() - begun


def main() -> None:
    """Measure and print the table, and write it if a path is given."""
    rows = []
    for name, medium in MEDIA.items():
        for estimator in ("spectral", "analog"):
            splits.spectrophotometer(medium, [500, 1500], max_stderr=0.2, estimator=estimator)
        spectral = seconds(medium, "spectral", WAVELENGTHS)
        part = WAVELENGTHS[::10]
        analog = seconds(medium, "analog", part) * WAVELENGTHS.size / part.size
        rows.append(
            {
                "medium": name,
                "max_stderr": STDERR,
                "wavelengths": WAVELENGTHS.size,
                "spectral_s": spectral,
                "analog_s": analog,
                "ratio": analog / spectral,
            }
        )
        print(
            f"{name}: {WAVELENGTHS.size} wavelengths at {STDERR:g}: spectral {spectral:.1f} s, "
            f"analog {analog:.0f} s, ratio {analog / spectral:.0f}",
            flush=True,
        )
    if len(sys.argv) > 1:
        pd.DataFrame(rows).to_csv(sys.argv[1], index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
