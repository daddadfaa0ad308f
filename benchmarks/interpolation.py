"""How much reflectance bends with refractive index: the constant behind interpolation's bound.

The spectral estimator interpolates linearly between index nodes and bounds what this misses by
t(1−t)/2 · CURVATURE · (Δc/c)², c the contrast of grain and pore.  This program measures the
second derivative of reflectance and transmittance by ln c from three indices with absorption
fixed, for dry, wet and water-filled snow, and prints it with its standard error.

    python benchmarks/interpolation.py
"""

from __future__ import annotations

import numpy as np

import splits
from splits.instruments.nodes import CURVATURE

# Wider apart than any spectrum spreads them, so that the bend shows beyond the noise.
INDICES = {
    "dry": (0.0, (1.42, 1.31, 1.233), (1.0, 1.0, 1.0)),
    "wet, S = 0.05": (0.05, (1.42, 1.31, 1.233), (1.44, 1.33, 1.253)),
    "wet, S = 0.3": (0.3, (1.42, 1.31, 1.233), (1.44, 1.33, 1.253)),
    "water-filled": (1.0, (1.3, 1.3, 1.3), (1.3195, 1.326, 1.3351)),
}
ABSORPTION = (1e-9, 1e-6, 1e-5)


def main() -> None:
    """Print one line per saturation and absorption."""
    for name, (saturation, ices, waters) in INDICES.items():
        for k in ABSORPTION:
            values, errors = [], []
            for seed, (ice, water) in enumerate(zip(ices, waters, strict=True)):
                snow = splits.Snow(
                    saturation=saturation,
                    depth_m=0.03,
                    refractive_index={"ice": complex(ice, k), "water": complex(water, k)},
                )
                ds = splits.spectrophotometer(snow, [1000], max_stderr=0.002, seed=seed)
                values.append([float(ds.reflectance[0]), float(ds.transmittance[0])])
                errors.append([float(ds.reflectance_stderr[0]), float(ds.transmittance_stderr[0])])
            pore = np.array(waters) if saturation == 1.0 else np.ones(3)
            x = np.log(np.abs(np.array(ices) / pore - 1.0))
            d = np.array([(x[0] - x[1]) * (x[0] - x[2]), (x[1] - x[0]) * (x[1] - x[2]),
                          (x[2] - x[0]) * (x[2] - x[1])])  # fmt: skip
            bend = 2.0 * (np.array(values) / d[:, np.newaxis]).sum(axis=0)
            error = 2.0 * np.sqrt(((np.array(errors) / d[:, np.newaxis]) ** 2).sum(axis=0))
            print(
                f"{name}, k {k:g}: reflectance {bend[0]:+.2f} ± {error[0]:.2f}, "
                f"transmittance {bend[1]:+.2f} ± {error[1]:.2f} (bound {CURVATURE:g})",
                flush=True,
            )


if __name__ == "__main__":
    main()
