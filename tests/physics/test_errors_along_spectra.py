"""Stated errors of what combines wavelengths, against the scatter of repeated runs."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT, judge_p
from scipy.stats import chi2

import splits
from splits.analysis.colour import make_colour_table
from splits.core.uncertainty import compute_error_parts
from splits.illumination.bands import SpectralBand

SEEDS = range(1, 61)
FEW = np.array([450, 560, 700, 860, 1030, 1100, 1240, 1300, 1500, 1650, 1800, 2200], dtype=float)
WIDE = np.union1d(np.arange(400.0, 781.0, 10.0), FEW)
NARROW = np.union1d(np.arange(400.0, 781.0, 10.0), [860.0, 900.0, 950.0, 1000.0])
FRESH = splits.Snow.natural(
    specific_surface_area_m2_kg=50, density_kg_m3=150, depth_m=0.02,
    impurities_ng_g={"black_carbon": 100},
)  # fmt: skip
OLD = splits.Snow.natural(
    specific_surface_area_m2_kg=10, depth_m=0.2, liquid_water_content=0.03
)  # fmt: skip
MEDIA = {
    "Table 1": splits.Snow(),
    "natural": splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.3),
    "wet": OLD,
    "pack on soil": splits.Stack([FRESH, OLD], ground=0.2),
    "thin": splits.Snow(depth_m=0.01, saturation=0.3),
    "sand": splits.Sand(),
}
"""Chosen before any was run."""


def combined(run):
    """Return what combines wavelengths by name: value, scatter stated and what may be missed."""
    w, r = run.wavelength.values, run.reflectance.values
    few = np.isin(w, FEW)
    signs = np.zeros(w.size)
    signs[few] = np.where(np.arange(few.sum()) % 2, -1.0, 1.0)
    sun = splits.sky("midlatitude_winter").compute_weights(w, SpectralBand.from_limits(w[0], w[-1]))
    long = 1240.0 if 1240.0 in w else 1000.0
    one, other = w == 860.0, w == long
    a, b = float(r[one][0]), float(r[other][0])
    ratio = (2.0 * b * one - 2.0 * a * other) / (a + b) ** 2
    found = {
        "sum": few / few.sum(), "differences": signs, "broadband": sun / sun.sum(),
    }  # fmt: skip
    values = {name: float(weight @ r) for name, weight in found.items()}
    values["ratio"], found["ratio"] = (a - b) / (a + b), ratio
    three = {}
    for name, weight in found.items():
        parts = compute_error_parts(run, "reflectance", xr.DataArray(weight, dims="wavelength"))
        three[name] = (values[name], *map(float, parts))
    table = make_colour_table(run.sel(wavelength=slice(400.0, 780.0))).iloc[0]
    for axis in "Lab":
        three[f"{axis}*"] = tuple(
            table[axis + end] for end in ("", "_stderr", "_interpolation_bound")
        )
    return three


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.slow
def test_what_combines_wavelengths_scatters_as_stated():
    """The spread of a ratio over 60 seeds is 9 %; the means over six media are judged at 15 %.

    Seeds show scatter; what interpolation misses is the same for all of them, and is left aside.
    """
    freedom = len(SEEDS) - 1
    squares, whole, p = {}, {}, {}
    for name, medium in MEDIA.items():
        wavelengths = NARROW if isinstance(medium, splits.Sand) else WIDE
        runs = [
            combined(splits.spectrophotometer(medium, wavelengths, max_stderr=0.01, seed=seed))
            for seed in SEEDS
        ]
        for key in runs[0]:
            values, errors, missed = np.array([run[key] for run in runs]).T
            square = values.var(ddof=1) / (errors**2).mean()
            squares.setdefault(key, []).append(square)
            stated = (errors**2 + missed**2).mean()
            whole.setdefault(key, []).append(values.var(ddof=1) / stated)
            below = chi2.cdf(freedom * square, freedom)
            p[f"{key} of {name}"] = 2.0 * min(below, 1.0 - below)
        print(name, {key: round(float(np.sqrt(all_[-1])), 2) for key, all_ in squares.items()})
    ratios = {key: float(np.sqrt(np.mean(all_))) for key, all_ in squares.items()}
    print("scatter over stated scatter:", {key: round(r, 2) for key, r in ratios.items()})
    both = {key: round(float(np.sqrt(np.mean(all_))), 2) for key, all_ in whole.items()}
    print("scatter over the whole error:", both)
    assert all(0.85 < value < 1.15 for value in ratios.values()), ratios
    judge_p(p)
