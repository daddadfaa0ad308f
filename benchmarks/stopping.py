"""Bias of the stopping rule: runs stop on their own estimated error, which biases low values.

Snow of SPLITSnow Table 1 at 211 wavelengths, many seeds at one error, compared with a reference of
a fifth of that error.  Printed by band: the mean deviation over seeds in units of the stated error,
with its standard error, and the ratio of the scatter between seeds to the stated error.

    python benchmarks/stopping.py [--seeds 200] [--max-stderr 0.003]
"""

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
    """Print one line per band."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--max-stderr", type=float, default=0.003)
    arguments = parser.parse_args()
    snow = splits.Snow()

    def run(error: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
        spectrum = splits.spectrophotometer(snow, WAVELENGTHS_NM, max_stderr=error, seed=seed)
        return spectrum.reflectance.values, spectrum.reflectance_stderr.values

    reference, reference_error = run(0.2 * arguments.max_stderr, 1_000_000)
    runs = [run(arguments.max_stderr, seed) for seed in range(arguments.seeds)]
    values, errors = (np.stack([one[row] for one in runs]) for row in (0, 1))
    stated = np.sqrt((errors**2).mean(axis=0))
    bias = (values.mean(axis=0) - reference) / stated
    noise = np.hypot(values.std(axis=0) / np.sqrt(arguments.seeds), reference_error) / stated
    scatter = values.std(axis=0, ddof=1) / stated
    print(
        f"{arguments.seeds} seeds, largest error {arguments.max_stderr:g}; "
        "in units of stated errors"
    )
    for band, (low, high) in SENSOR_BANDS.items():
        inside = (low <= WAVELENGTHS_NM) & (high >= WAVELENGTHS_NM)
        print(
            f"  {band}: reflectance {reference[inside].mean():.3f}, "
            f"bias {bias[inside].mean():+.2f} ± {noise[inside].mean():.2f} (largest "
            f"{np.abs(bias[inside]).max():.2f}), scatter {scatter[inside].mean():.2f} "
            f"(largest {scatter[inside].max():.2f})",
            flush=True,
        )


if __name__ == "__main__":
    main()
