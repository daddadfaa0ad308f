"""Particle layers with smooth interfaces against exact plane-parallel radiative transfer."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from chi2 import judge_z
from numba import config

import splits

REFERENCE = Path(__file__).with_name("reference")
compiled = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="millions of rays")


def make_layer(row: pd.Series) -> splits.ParticleLayer:
    """Return the layer of a row of plane_parallel.csv."""
    return splits.ParticleLayer(
        optical_thickness=row.tau,
        single_scattering_albedo=row.ssa,
        asymmetry=row.g,
        refractive_index=row.n,
        bottom_albedo=None if row.n > 1.0 else row.lambert_bottom,
    )


def compare_with_reference(max_stderr: float) -> tuple[np.ndarray, int]:
    """Return deviations from all rows of plane_parallel.csv, in standard errors.

    The second number counts exact values: an infinite layer transmits nothing, and reflects
    everything without absorption.
    """
    table = pd.read_csv(REFERENCE / "plane_parallel.csv", comment="#")
    z, n_exact = [], 0
    for number, (_, row) in enumerate(table.iterrows()):
        incidence = float(np.degrees(np.arccos(row.mu0)))
        ds = splits.spectrophotometer(make_layer(row), [550.0], incidence, max_stderr, number)
        assert ds.attrs["stop_reason"] == "converged"
        transmitted_fraction = 1.0 - (row.lambert_bottom if row.n == 1.0 else 0.0)
        for name, exact in (
            ("reflectance", row.R),
            ("transmittance", row["T"] * transmitted_fraction),
        ):
            value, stderr = float(ds[name][0]), float(ds[f"{name}_stderr"][0])
            assert stderr <= max_stderr
            if exact in (0.0, 1.0):
                assert value == exact
                n_exact += 1
            else:
                z.append((value - exact) / math.hypot(stderr, row.est_err))
    return np.array(z), n_exact


@compiled
@pytest.mark.parametrize("error", [6e-3, pytest.param(1e-3, marks=pytest.mark.long)])
def test_reflectance_and_transmittance_agree_with_reference(error):
    # benchmarks/other_models.py makes the same comparison to an error of 2e-4.
    z, n_exact = compare_with_reference(error)
    # Each row is a separate run with a reflectance and, unless infinite, a transmittance.
    judge_z(z, f"reflectance and transmittance ({n_exact} exact)", independent=(z.size + 1) // 2)


@pytest.mark.long
@compiled
def test_slab_agrees_with_van_de_hulst():
    slab = splits.ParticleLayer(
        optical_thickness=2.0,
        single_scattering_albedo=0.9,
        asymmetry=0.75,
        refractive_index=1.0,
        bottom_albedo=None,
    )
    ds = splits.spectrophotometer(slab, [550.0], 0.0, 2e-4)
    # The error of a printed table is half a unit of its last digit.
    z = [
        (float(ds[name][0]) - exact) / math.hypot(float(ds[f"{name}_stderr"][0]), 5e-6)
        for name, exact in (("reflectance", 0.09739), ("transmittance", 0.66096))
    ]
    table = pd.read_csv(REFERENCE / "van_de_hulst_table35.csv", comment="#")
    table = table[table.mu > 0.0].sort_values("mu", ascending=False)
    polar = np.degrees(np.arccos(table.mu.to_numpy()))
    angular = splits.goniophotometer(
        slab, [550.0], 0.0, seed=2, relative_stderr=0.003, polar_deg=polar, azimuth_deg=[0.0],
        estimator="next_event",
    )  # fmt: skip
    for name, exact in (("brdf", table.R), ("btdf", table["T"])):
        value, stderr = (np.pi * angular[f"{name}{end}"].values.ravel() for end in ("", "_stderr"))
        z += list((value - exact) / np.hypot(stderr, 5e-6))
    judge_z(z, "van de Hulst's slab", independent=2)


@pytest.mark.long
@compiled
def test_rayleigh_layers_agree_with_polarized_reference():
    table = pd.read_csv(REFERENCE / "rayleigh_polarized.csv", comment="#")
    z = []
    for number, (key, rows) in enumerate(table.groupby(["tau", "ssa", "lambert_bottom", "mu0"])):
        tau, ssa, bottom, mu0 = key
        layer = splits.ParticleLayer(
            optical_thickness=tau,
            single_scattering_albedo=ssa,
            refractive_index=1.0,
            bottom_albedo=bottom,
            phase_function="rayleigh",
            polarized=True,
        )
        rows = rows.sort_values(["mu", "phi_deg"], ascending=[False, True])
        ds = splits.goniophotometer(
            layer, [550.0], float(np.degrees(np.arccos(mu0))), seed=number, relative_stderr=0.005,
            polar_deg=np.degrees(np.arccos(np.sort(rows.mu.unique())[::-1])),
            azimuth_deg=np.sort(rows.phi_deg.unique()), estimator="next_event",
        )  # fmt: skip
        # The reference has a flux of pi across the beam, and Q > 0 across the meridian plane.
        scale = np.pi * mu0
        for name, exact in (("brdf", rows.I), ("brdf_q", -rows.Q), ("brdf_u", rows.U)):
            value, stderr = (scale * ds[f"{name}{end}"].values.ravel() for end in ("", "_stderr"))
            exact = exact.to_numpy()
            assert (stderr <= 0.01 * rows.I).all()
            uncertain = stderr > 0.0
            # In the principal plane symmetry keeps the plane of polarization.
            assert (np.abs(value - exact)[~uncertain] < 1e-7).all()
            z.append(((value - exact) / np.hypot(stderr, rows.stream_change.to_numpy()))[uncertain])
    judge_z(np.concatenate(z), "I, Q, U of Rayleigh layers", independent=len(z) // 3)
