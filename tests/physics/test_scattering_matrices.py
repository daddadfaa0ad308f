"""Layers of particles with scattering matrices against published polarized benchmarks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from chi2 import NEEDS_JIT, judge_z, scale_sample_size
from scattering_matrices import make_matrix

import splits

REFERENCE = Path(__file__).with_name("reference")
STOKES = {"I": "", "Q": "_q", "U": "_u", "V": "_v"}
FREE = {"refractive_index": 1.0, "bottom_albedo": None, "polarized": True}
RAYLEIGH = {**FREE, "phase_function": "rayleigh", "single_scattering_albedo": 1.0}
CASES = {
    ("A1", 0.0): {**RAYLEIGH, "optical_thickness": 0.5},
    ("A1", 0.03): {**RAYLEIGH, "optical_thickness": 0.5, "depolarization": 0.03},
    ("A1", 0.1): {**RAYLEIGH, "optical_thickness": 0.5, "depolarization": 0.1},
    ("A2", 0.03): {
        **RAYLEIGH, "optical_thickness": 0.1, "depolarization": 0.03, "bottom_albedo": 0.3,
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
"""Layers of the intercomparison of Emde et al. (2015), see iprt_phase_a.csv."""


def compare_with_benchmark(case: tuple[str, float], rays: int) -> pd.DataFrame:
    """Return deviations of the Stokes vector from a case, in standard errors, by direction."""
    table = pd.read_csv(REFERENCE / "iprt_phase_a.csv", comment="#")
    table = table[(table.case == case[0]) & (table.depolarization == case[1])]
    if case[0] == "A2":
        # Nothing leaves through a Lambertian bottom.
        table = table[table.side == "reflected"]
    incidence = float(table.solar_zenith_deg.iloc[0])
    ds = splits.goniophotometer(
        splits.ParticleLayer(**CASES[case]), [350.0], incidence, rays=rays,
        polar_deg=np.unique(table.polar_deg), azimuth_deg=np.unique(table.azimuth_deg),
        estimator="next_event",
    ).squeeze("wavelength")  # fmt: skip
    flux = np.cos(np.radians(incidence))
    z = {name: np.full(len(table), np.nan) for name in STOKES}
    for row, expected in enumerate(table.itertuples()):
        at = ds.sel(polar=expected.polar_deg, azimuth=expected.azimuth_deg)
        function = "brdf" if expected.side == "reflected" else "btdf"
        for name, suffix in STOKES.items():
            value, stderr = (
                flux * float(at[f"{function}{suffix}{end}"]) for end in ("", "_stderr")
            )
            exact, uncertainty = (getattr(expected, f"{name}{end}") for end in ("", "_std"))
            total = np.hypot(stderr, uncertainty)
            if total > 0.0:
                z[name][row] = (value - exact) / total
            else:
                assert abs(value - exact) < 1e-7
    return pd.DataFrame(z)


def judge_stokes(z: pd.DataFrame, label: str) -> None:
    """Judge each Stokes parameter; directions share their rays."""
    for name in STOKES:
        values = z[name].dropna().to_numpy()
        if values.size:
            judge_z(values, f"{label}, {name}", independent=max(values.size // 12, 1))


@NEEDS_JIT
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0]}-{case[1]:g}")
def test_stokes_vectors_agree_with_the_intercomparison(case):
    judge_stokes(compare_with_benchmark(case, 100_000), f"case {case[0]}, {case[1]:g}")


@pytest.mark.long
@NEEDS_JIT
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0]}-{case[1]:g}")
def test_stokes_vectors_agree_with_the_intercomparison_to_high_precision(case):
    judge_stokes(compare_with_benchmark(case, 1_000_000), f"case {case[0]}, {case[1]:g}")


@pytest.mark.long
@NEEDS_JIT
def test_reflection_of_a_semi_infinite_layer():
    """First columns of the reflection matrices of Mishchenko et al. (1999), at µ = µ0 = 0.5.

    Their azimuth increases in the other sense, which reverses U and V; the intercomparison above
    determines these signs independently.
    """
    expected = {0: (1.054548, -0.005217, 0.0, 0.0), 1: (0.039998, 0.007864, -0.014080, 0.000034)}
    layer = splits.ParticleLayer(
        **FREE, optical_thickness=float("inf"), single_scattering_albedo=1.0,
        scattering_matrix=REFERENCE / "half_space_coefficients.csv",
    )  # fmt: skip
    # Azimuths on both sides: a Fourier coefficient has only coefficients of orders near 24 added.
    azimuth = np.arange(0.0, 360.0, 15.0)
    ds = splits.goniophotometer(
        layer, [550.0], 60.0, rays=50_000, polar_deg=[60.0], azimuth_deg=azimuth,
        estimator="next_event",
    ).squeeze(("wavelength", "polar"))  # fmt: skip
    z = []
    for order, column in expected.items():
        for (name, suffix), exact in zip(STOKES.items(), column, strict=True):
            function = np.cos if name in "IQ" else np.sin
            weight = function(order * np.radians(azimuth)) / azimuth.size
            value = np.pi * float((ds[f"brdf{suffix}"] * weight).sum())
            # Errors of directions are taken as fully correlated, which bounds that of the sum.
            stderr = np.pi * float((ds[f"brdf{suffix}_stderr"] * np.abs(weight)).sum())
            if stderr > 0.0:
                z.append((value - exact) / stderr)
                print(f"order {order}, {name}: {value:.6f} ± {stderr:.6f}, exact {exact:.6f}")
    judge_z(np.array(z), "semi-infinite layer", bound_added=True)


@NEEDS_JIT
def test_two_layers_of_half_the_thickness_are_the_layer():
    settings = {
        "refractive_index": 1.33, "polarized": True, "single_scattering_albedo": 0.98,
        "bottom_albedo": None, "scattering_matrix": make_matrix(0.9),
    }  # fmt: skip
    whole = splits.ParticleLayer(optical_thickness=2.0, **settings)
    half = splits.ParticleLayer(optical_thickness=1.0, depth_m=0.5, **settings)
    one, two = (
        splits.goniophotometer(
            medium, [550.0], 50.0, rays=scale_sample_size(100_000), seed=seed,
            polar_deg=[0.0, 25.0, 60.0], azimuth_deg=[0.0, 60.0, 135.0], estimator="next_event",
        )
        for seed, medium in ((1, whole), (2, splits.Stack([half, half])))
    )  # fmt: skip
    for name in (
        f"{function}{suffix}" for function in ("brdf", "btdf") for suffix in STOKES.values()
    ):
        stderr = np.hypot(one[f"{name}_stderr"], two[f"{name}_stderr"]).values
        z = ((one[name] - two[name]).values / stderr)[stderr > 0.0]
        judge_z(z, f"two layers, {name}", independent=2)
