"""What stopping does: runs end on the error of their own rays, which may draw dark values low.

Snow of SPLITSnow Table 1 at 211 wavelengths, many seeds at one error, against a reference of a
fifth of that error.  Printed by band: the mean deviation over seeds in units of the stated errors,
with its own error, and the scatter between seeds over the stated error.

    python benchmarks/stopping.py [--seeds 200] [--max-stderr 0.003]
"""

from __future__ import annotations

import argparse

import numpy as np

import splits

WAVELENGTHS_NM = np.arange(400, 2501, 10)
SENSOR_BANDS = {
    "400-800 nm": (400, 800),
    "900-1400 nm": (900, 1400),
    "1450-1600 nm": (1450, 1600),
    "1950-2100 nm": (1950, 2100),
    "2400-2500 nm": (2400, 2500),
}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--max-stderr", type=float, default=0.003)
    given = parser.parse_args()
    snow = splits.Snow()

    def run(error: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
        spectrum = splits.spectrophotometer(snow, WAVELENGTHS_NM, max_stderr=error, seed=seed)
        return spectrum.reflectance.values, spectrum.reflectance_stderr.values

    truth, its_error = run(0.2 * given.max_stderr, 1_000_000)
    runs = [run(given.max_stderr, seed) for seed in range(given.seeds)]
    values, errors = (np.stack([one[row] for one in runs]) for row in (0, 1))
    stated = np.sqrt((errors**2).mean(axis=0))
    shift = (values.mean(axis=0) - truth) / stated
    noise = np.hypot(values.std(axis=0) / np.sqrt(given.seeds), its_error) / stated
    scatter = values.std(axis=0, ddof=1) / stated
    print(f"{given.seeds} seeds, largest error {given.max_stderr:g}; in units of stated errors")
    for band, (low, high) in SENSOR_BANDS.items():
        inside = (low <= WAVELENGTHS_NM) & (high >= WAVELENGTHS_NM)
        print(
            f"  {band}: reflectance {truth[inside].mean():.3f}, shift {shift[inside].mean():+.2f} "
            f"± {noise[inside].mean():.2f} (most {np.abs(shift[inside]).max():.2f}), scatter "
            f"{scatter[inside].mean():.2f} (most {scatter[inside].max():.2f})",
            flush=True,
        )


if __name__ == "__main__":
    main()
