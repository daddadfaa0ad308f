"""Layers of particles with scattering matrices against published polarized benchmarks."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from chi2 import NEEDS_JIT, compare_results, judge_z, scale_sample_size
from scattering_matrices import make_matrix
from scipy.interpolate import CubicSpline

import splits

REFERENCE = Path(__file__).with_name("reference")
STOKES = {"I": "", "Q": "_q", "U": "_u", "V": "_v"}
FREE = {"refractive_index": 1.0, "ground": None, "polarized": True}
RAYLEIGH = {**FREE, "phase_function": "rayleigh", "single_scattering_albedo": 1.0}
CASES = {
    ("A1", 0.0): {**RAYLEIGH, "optical_thickness": 0.5},
    ("A1", 0.03): {**RAYLEIGH, "optical_thickness": 0.5, "depolarization": 0.03},
    ("A1", 0.1): {**RAYLEIGH, "optical_thickness": 0.5, "depolarization": 0.1},
    ("A2", 0.03): {
        **RAYLEIGH, "optical_thickness": 0.1, "depolarization": 0.03, "ground": 0.3,
    },
    ("A3", 0.0): {
        **FREE, "optical_thickness": 0.2, "single_scattering_albedo": 0.97568,
        "scattering_matrix": REFERENCE / "iprt_a3_spheres.csv",
    },
    ("A4", 0.0): {
        **FREE, "optical_thickness": 0.2, "single_scattering_albedo": 0.78758,
        "scattering_matrix": REFERENCE / "iprt_a4_spheroids.csv",
    },
    ("A5", 0.0): {
        **FREE, "optical_thickness": 5.0, "single_scattering_albedo": 0.999979,
        "scattering_matrix": REFERENCE / "iprt_a5_cloud.csv",
    },
}  # fmt: skip
"""Layers of the intercomparison of Emde et al. (2015), see iprt_phase_a.csv.xz."""
RAYS_OF_ALL_DIRECTIONS = {"A1": 400_000, "A2": 1_000_000, "A3": 1_000_000, "A4": 1_000_000}
"""Rays of the comparison in every direction; 50 000 in case A5, whose forward peak is costly."""
MAX_INDEPENDENT = 6
"""Bound on the number of independent comparisons of a run, whose directions share their rays."""


def read_benchmark(case: tuple[str, float]) -> pd.DataFrame:
    """Return the published Stokes vectors of a case, in all directions."""
    table = pd.read_csv(REFERENCE / "iprt_phase_a.csv.xz", comment="#")
    return table[(table.case == case[0]) & (table.depolarization == case[1])]


def compare_with_benchmark(case: tuple[str, float], table: pd.DataFrame, rays: int) -> pd.DataFrame:
    """Return deviations of the Stokes vector from a table, in standard errors, by direction."""
    if CASES[case]["ground"] is not None:
        # Next-event estimation has no light that arrives at a Lambertian bottom.
        table = table[table.side == "reflected"]
    incidence = float(table.solar_zenith_deg.iloc[0])
    ds = splits.goniophotometer(
        splits.ParticleLayer(**CASES[case]), [350.0], incidence, rays=rays,
        polar_deg=np.unique(table.polar_deg), azimuth_deg=np.unique(table.azimuth_deg),
        estimator="next_event",
    ).squeeze("wavelength")  # fmt: skip
    flux = np.cos(np.radians(incidence))
    z = []
    for side, rows in table.groupby("side"):
        at = ds.sel(polar_deg=rows.polar_deg.to_xarray(), azimuth_deg=rows.azimuth_deg.to_xarray())
        function = "brdf" if side == "reflected" else "btdf"
        z.append(pd.DataFrame(index=rows.index))
        for name, suffix in STOKES.items():
            value, stderr = (
                flux * at[f"{function}{suffix}{end}"].to_numpy() for end in ("", "_stderr")
            )
            total = np.hypot(stderr, rows[f"{name}_std"].to_numpy())
            deviation = value - rows[name].to_numpy()
            assert (np.abs(deviation[total == 0.0]) < 1e-7).all()
            z[-1][name] = np.divide(
                deviation, total, out=np.full(len(rows), np.nan), where=total > 0.0
            )
    return pd.concat(z)


def judge_stokes(z: pd.DataFrame, label: str) -> None:
    """Judge each Stokes parameter; directions share their rays."""
    for name in STOKES:
        values = z[name].dropna().to_numpy()
        if values.size:
            independent = min(max(values.size // 12, 1), MAX_INDEPENDENT)
            judge_z(values, f"{label}, {name}", independent)


def select_directions(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of a table in steps of 20° in polar angle and of 30° in azimuth."""
    return table[(table.polar_deg % 20.0 == 0.0) & (table.azimuth_deg % 30.0 == 0.0)]


@NEEDS_JIT
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0]}-{case[1]:g}")
@pytest.mark.parametrize(
    "rays", [100_000, pytest.param(1_000_000, marks=pytest.mark.long)], ids=["short", "long"]
)
def test_stokes_vectors_agree_with_the_intercomparison(case, rays):
    table = select_directions(read_benchmark(case))
    label = f"case {case[0]}, {case[1]:g}"
    # The forward peak of case A5 is costly.
    rays = rays // 3 if case[0] == "A5" else rays
    judge_stokes(compare_with_benchmark(case, table, rays), label)


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0]}-{case[1]:g}")
def test_every_direction_agrees_with_the_intercomparison(case):
    table = read_benchmark(case)
    label = f"all of case {case[0]}, {case[1]:g}"
    rays = RAYS_OF_ALL_DIRECTIONS.get(case[0], 50_000)
    if case[0] != "A5":
        judge_stokes(compare_with_benchmark(case, table, rays), label)
        return
    # The directions are those of the principal plane and of a cone, two grids.
    for is_in_plane, rows in table.groupby(table.azimuth_deg % 180.0 == 0.0):
        z = compare_with_benchmark(case, rows, rays)
        judge_stokes(z, f"{label}, {'principal plane' if is_in_plane else 'cone'}")


def average_over_bins(table: pd.DataFrame, name: str, n_bins: tuple[int, int]) -> np.ndarray:
    """Return means of a Stokes parameter over bins, weighted by projected solid angle.

    The bins next to the horizon, which the table does not cover, are left out.
    """
    values = table.pivot_table(index="polar_deg", columns="azimuth_deg", values=name)
    half = values.to_numpy()
    # The table has azimuths from 0 to 180°; U and V change their sign in the mirror image.
    sign = -1.0 if name in "UV" else 1.0
    spline = CubicSpline(values.index, np.hstack([half, sign * half[:, -2:0:-1]]))
    x, weight = np.polynomial.legendre.leggauss(8)
    edges = np.arange(n_bins[0], 0, -1) / n_bins[0]
    means = []
    for high, low in pairwise(edges):
        mu = low + 0.5 * (high - low) * (1.0 + x)
        by_azimuth = (weight * mu) @ spline(np.degrees(np.arccos(mu))) / (weight * mu).sum()
        # Trapezoidal rule over azimuths, with ends halfway between centres.
        step = by_azimuth.size // n_bins[1]
        share = np.append(np.append(0.5, np.ones(step - 1)), 0.5) / step
        index = step * np.arange(n_bins[1])[:, np.newaxis] + np.arange(step + 1) - step // 2
        means.append(by_azimuth[index % by_azimuth.size] @ share)
    return np.array(means)


@NEEDS_JIT
@pytest.mark.parametrize("rays", [300_000, pytest.param(10_000_000, marks=pytest.mark.long)])
def test_light_at_a_lambertian_bottom_agrees_with_the_intercomparison(rays):
    """Bins of case A2, in which the bottom absorbs a part of the light that arrives."""
    case, n_bins = ("A2", 0.03), (5, 12)
    table = read_benchmark(case)
    table = table[table.side == "transmitted"]
    incidence = float(table.solar_zenith_deg.iloc[0])
    ds = splits.goniophotometer(
        splits.ParticleLayer(**CASES[case]), [350.0], incidence, rays=rays, estimator="bins",
        n_bins=n_bins,
    ).squeeze("wavelength")  # fmt: skip
    scale = np.cos(np.radians(incidence)) / (1.0 - CASES[case]["ground"])
    for name in "IQU":
        expected = average_over_bins(table, name, n_bins)
        value, stderr = (
            scale * ds[f"btdf{STOKES[name]}{end}"].to_numpy()[: len(expected)]
            for end in ("", "_stderr")
        )
        judge_z((value - expected) / stderr, f"case A2, bottom, {name}")


@NEEDS_JIT
def test_two_layers_of_half_the_thickness_are_the_layer():
    settings = {
        "refractive_index": 1.33, "polarized": True, "single_scattering_albedo": 0.98,
        "ground": None, "scattering_matrix": make_matrix(0.9),
    }  # fmt: skip
    whole = splits.ParticleLayer(optical_thickness=2.0, **settings)
    half = splits.ParticleLayer(optical_thickness=1.0, depth_m=0.5, **settings)
    one, two = (
        splits.goniophotometer(
            medium, [550.0], 50.0, rays=scale_sample_size(50_000), seed=seed,
            polar_deg=[0.0, 25.0, 60.0], azimuth_deg=[0.0, 60.0, 135.0], estimator="next_event",
        )
        for seed, medium in ((1, whole), (2, splits.Stack([half, half])))
    )  # fmt: skip
    for name in (
        f"{function}{suffix}" for function in ("brdf", "btdf") for suffix in STOKES.values()
    ):
        judge_z(compare_results(one, two, name), f"two layers, {name}", independent=2)
