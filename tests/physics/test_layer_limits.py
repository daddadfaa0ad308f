"""Particle layers against analytical results and exact plane-parallel radiative transfer."""

import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from chi2 import NEEDS_JIT, compare_results, compute_z_bound, judge_scatter, judge_z
from numba import config
from scattering_matrices import make_matrix

import splits
from splits.instruments.detector_tally import make_detectors
from splits.kernels.interface import fresnel
from splits.kernels.scene import make_bounding_optics
from splits.kernels.transport.history import trace_to_detectors
from splits.kernels.transport.next_event import ABOVE
from splits.simulation.scene import build_scene, compute_material_constants

NM = [550.0]
CONSERVATIVE = {"single_scattering_albedo": 1.0, "ground": 1.0}


def get_value(ds, name: str) -> tuple[float, float]:
    """Return a quantity and its standard error."""
    return float(ds[name][0]), float(ds[f"{name}_stderr"][0])


def plate_fluxes(index: float, cosine: float) -> tuple[float, float]:
    """Return R and T of a transparent plate, by the geometric series of its reflections."""
    r = fresnel(1.0, index, 0.0, cosine)[0]
    return 2.0 * r / (1.0 + r), (1.0 - r) / (1.0 + r)


@pytest.mark.parametrize("incidence", [0.0, 60.0, 89.9])
@pytest.mark.parametrize("index", [1.0, 1.5])
def test_layer_without_particles_is_a_plate(index, incidence):
    plate = splits.ParticleLayer(optical_thickness=0.0, refractive_index=index, ground=None)
    ds = splits.spectrophotometer(plate, NM, incidence, max_stderr=0.01)
    expected = plate_fluxes(index, math.cos(math.radians(incidence)))
    (value, stderr), (exact, transmitted) = get_value(ds, "reflectance"), expected
    assert float(ds.transmittance[0]) - transmitted == pytest.approx(exact - value, abs=1e-12)
    if index == 1.0:
        assert value == 0.0
    else:
        judge_z([(value - exact) / stderr], "plate")
    assert float(ds.absorptance[0]) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("polarized", [False, True])
@pytest.mark.parametrize(
    "settings",
    [
        {"optical_thickness": 10.0},
        {"optical_thickness": 1e4, "asymmetry": 0.99},
        {"optical_thickness": 5.0, "asymmetry": -0.99},
        {"optical_thickness": 3.0, "phase_function": "rayleigh"},
        {"optical_thickness": math.inf, "asymmetry": 0.5},
    ],
)
def test_conservative_layer_on_white_bottom_reflects_all(settings, polarized):
    layer = splits.ParticleLayer(**CONSERVATIVE, polarized=polarized, **settings)
    ds = splits.spectrophotometer(layer, NM, 30.0, max_stderr=0.5)
    assert float(ds.reflectance[0]) == pytest.approx(1.0, abs=1e-12)


@NEEDS_JIT
@pytest.mark.parametrize("error", [0.002, pytest.param(0.001, marks=pytest.mark.long)])
def test_thick_conservative_layer_follows_diffusion_theory(error):
    # T = 4/3 K0(1)/((1 − g) τ + 2 × 0.7104) of a thick conservative slab, exact for isotropic
    # scattering with K0(1) = √3/4 H(1) = 1.2591; for other phase functions 1.26 to 1.28
    # (van de Hulst 1980), hence 2 %.
    layer = splits.ParticleLayer(
        optical_thickness=1e4, single_scattering_albedo=1.0, asymmetry=0.99,
        refractive_index=1.0, ground=None,
    )  # fmt: skip
    ds = splits.spectrophotometer(layer, NM, 0.0, max_stderr=error)
    value, stderr = get_value(ds, "transmittance")
    expected = 4.0 / 3.0 * 1.2591 / (100.0 + 2.0 * 0.7104)
    assert abs(value - expected) < 0.02 * expected + compute_z_bound(1) * stderr
    assert float(ds.reflectance[0]) + value == pytest.approx(1.0, abs=1e-12)


def test_black_particles_transmit_only_the_direct_beam():
    layer = splits.ParticleLayer(
        optical_thickness=1.0, single_scattering_albedo=0.0, refractive_index=1.0,
        ground=None,
    )  # fmt: skip
    ds = splits.spectrophotometer(layer, NM, 60.0, max_stderr=0.01)
    value, stderr = get_value(ds, "transmittance")
    judge_z([(value - math.exp(-2.0)) / stderr], "black particles")
    assert float(ds.reflectance[0]) == 0.0


@pytest.mark.long
def test_polarization_has_no_effect_without_polarizers():
    """Particles whose P12 is 0 do not polarize unpolarized light."""
    angles = np.linspace(0.0, 180.0, 361)
    mu = np.cos(np.radians(angles))
    p11, zero = (1.0 - 0.75**2) / (1.0 + 0.75**2 - 1.5 * mu) ** 1.5, 0.0 * mu
    matrix = {"angle_deg": angles, "P11": p11, "P12": zero, "P33": 0.9 * mu * p11, "P34": zero}
    settings = {"optical_thickness": 2.0, "refractive_index": 1.0, "scattering_matrix": matrix}
    polar = np.array([0.0, 30.0, 60.0])
    pair = [
        splits.goniophotometer(
            splits.ParticleLayer(**settings, polarized=polarized), NM, 40.0, seed=seed,
            polar_deg=polar, azimuth_deg=[0.0, 90.0, 180.0], estimator="next_event",
            relative_stderr=0.01,
        )
        for seed, polarized in ((1, False), (2, True))
    ]  # fmt: skip
    judge_z(compare_results(*pair, "brdf"), "with and without polarization", independent=1)
    for name in ("brdf_q", "brdf_u", "brdf_v"):
        assert float(np.abs(pair[1][name]).max()) == 0.0


@pytest.mark.parametrize("particles", ["scalar", "polarized", "matrix"])
def test_brdf_obeys_helmholtz_reciprocity(particles):
    matrix = {"scattering_matrix": make_matrix(0.8)} if particles == "matrix" else {}
    layer = splits.ParticleLayer(
        optical_thickness=3.0, single_scattering_albedo=0.95, asymmetry=0.6, ground=0.3,
        polarized=particles != "scalar", **matrix,
    )  # fmt: skip
    pairs = [(0.0, 60.0, 0.0), (20.0, 70.0, 180.0), (35.0, 55.0, 90.0), (10.0, 80.0, 45.0)]
    z = []
    for number, (one, other, azimuth) in enumerate(pairs):
        forward, reverse = (
            splits.goniophotometer(
                layer, NM, a, seed=10 * number + seed, polar_deg=[b], azimuth_deg=[azimuth],
                estimator="next_event", relative_stderr=0.005,
            )
            for seed, (a, b) in enumerate(((one, other), (other, one)))
        )  # fmt: skip
        z.append(compare_results(forward.squeeze(drop=True), reverse.squeeze(drop=True), "brdf"))
    judge_z(z, f"reciprocity, {particles}")
    assert np.abs(z).max() < 3.0


@pytest.mark.long
def test_local_estimation_agrees_with_expansion():
    layer = splits.ParticleLayer(optical_thickness=2.0, asymmetry=0.5, ground=None)
    polar, azimuth = np.arange(0.0, 85.0, 10.0), [0.0, 90.0, 180.0]
    local, expansion = (
        splits.goniophotometer(
            layer, NM, 40.0, seed=seed, polar_deg=polar, azimuth_deg=azimuth, estimator=name
        )
        for seed, name in ((1, "next_event"), (2, "expansion"))
    )
    z = compare_results(
        local, expansion, "brdf", "btdf", "reflectance", "transmittance", "specular_reflectance",
        "direct_transmittance",
    )  # fmt: skip
    judge_z(z, "local estimation against expansion", independent=1)


def test_errors_of_local_estimation_from_few_batches():
    layer = splits.ParticleLayer(optical_thickness=2.0, asymmetry=0.5, ground=None)
    runs = [
        splits.goniophotometer(
            layer, NM, 40.0, rays=4000, seed=seed, estimator="next_event", polar_deg=[0.0, 60.0],
            azimuth_deg=[0.0, 180.0],
        )
        for seed in range(60)
    ]  # fmt: skip
    for name in ("brdf", "btdf", "reflectance", "transmittance"):
        judge_scatter(*([ds[name + end] for ds in runs] for end in ("", "_stderr")), name)


@pytest.mark.long
@NEEDS_JIT
def test_bins_and_local_estimation_agree_on_polarization():
    # With two interfaces, local estimation sums their multiple reflections; bins record rays only.
    layer = splits.ParticleLayer(
        optical_thickness=1.0, single_scattering_albedo=0.9, refractive_index=1.5,
        ground=None, phase_function="rayleigh", polarized=True,
    )  # fmt: skip
    bins = splits.goniophotometer(layer, NM, 50.0, estimator="bins", n_bins=(40, 36), rays=500_000)
    bins = bins.isel(polar_deg=bins.polar_deg.values < 75.0)
    local = splits.goniophotometer(
        layer, NM, 50.0, estimator="next_event", seed=2, relative_stderr=0.014,
        polar_deg=bins.polar_deg.values, azimuth_deg=[0.0, 30.0, 90.0, 150.0, 180.0, 270.0],
    )  # fmt: skip
    bins = bins.sel(azimuth_deg=local.azimuth_deg)
    for name in ("brdf", "brdf_q", "brdf_u", "brdf_v", "btdf", "btdf_q", "btdf_u", "btdf_v"):
        # The errors of bins, which use separate rays, dominate.
        judge_z(compare_results(bins, local, name), name)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"optical_thickness": -1.0}, "optical_thickness = -1.0"),
        ({"single_scattering_albedo": 1.1}, "single_scattering_albedo = 1.1"),
        ({"asymmetry": 1.0}, "asymmetry = 1.0"),
        ({"refractive_index": 0.9}, "refractive_index = 0.9"),
        ({"ground": 2.0}, "ground = 2.0"),
        ({"phase_function": "mie"}, "phase_function = 'mie'"),
        ({"phase_function": {"cosine": [-1, 1]}}, "cosine, density"),
        ({"phase_function": {"cosine": [-1, 0.5], "density": [1, 1]}}, "increasing from -1 to 1"),
        ({"polarized": "yes"}, "polarized = 'yes'"),
        ({"depth_m": 0.0}, "depth_m = 0.0"),
        ({"phase_function": {1: 2, "a": 3}}, "cosine, density"),
        ({"phase_function": {"cosine": [-1, 1], "density": [1e308, 1e308]}}, "0 to 1e100"),
    ],
)
def test_invalid_layers_are_rejected(settings, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        splits.ParticleLayer(**settings)


def test_instruments_for_grains_reject_particle_layers():
    with pytest.raises(ValueError, match="medium = 'particle_layer'"):
        splits.single_scattering(splits.ParticleLayer(), NM)
    with pytest.raises(ValueError, match="kernel = 'vectorized'"):
        splits.spectrophotometer(splits.ParticleLayer(), NM, kernel="vectorized")
    with pytest.raises(ValueError, match="estimator = 'next_event'"):
        splits.goniophotometer(splits.Snow(), NM, estimator="next_event")


def test_rare_events_have_nonzero_errors():
    # Very few rays enter at 89.9999 degrees, and very few hit a particle at a thickness of 1e-6.
    for layer, incidence in (
        (splits.ParticleLayer(), 89.9999),
        (
            splits.ParticleLayer(optical_thickness=1e-6, refractive_index=1.0, ground=None),
            0.0,
        ),
    ):
        ds = splits.goniophotometer(
            layer, NM, incidence, estimator="next_event", polar_deg=[0.0, 60.0], azimuth_deg=[0.0],
            max_rays=20_000,
        )  # fmt: skip
        assert (ds.brdf_stderr > 0.0).all()
        assert (ds.reflectance_stderr > 0.0).all()
    ds = splits.spectrophotometer(
        splits.ParticleLayer(
            optical_thickness=1e-3, single_scattering_albedo=0.0, ground=0.0
        ),
        NM, 0.0, max_stderr=0.01,
    )  # fmt: skip
    assert float(ds.absorptance_stderr[0]) > 0.0


def test_local_estimation_above_a_bottom_has_no_btdf():
    directions = {"polar_deg": [0.0], "azimuth_deg": [0.0], "estimator": "next_event"}
    with pytest.raises(ValueError, match="target = 'btdf'"):
        splits.goniophotometer(splits.ParticleLayer(), NM, 0.0, target="btdf", **directions)
    ds = splits.goniophotometer(splits.ParticleLayer(), NM, 0.0, rays=10_000, **directions)
    assert "btdf" not in ds and "brdf" in ds


@pytest.mark.parametrize("max_order", [0, 1])
def test_next_event_estimation_ends_at_the_largest_order(max_order):
    """The ground counts as one order of scattering; without particles it is the only one."""
    layer = splits.ParticleLayer(optical_thickness=0.0, refractive_index=1.0, ground=0.5)
    scene, zenith = build_scene(layer, 50.0, False, ground_albedo=0.5), np.array([0.0])
    detectors = make_detectors([layer], scene, zenith, zenith)
    scene = scene._replace(detectors=detectors)
    index, absorption = compute_material_constants(layer, np.array(NM))
    optics, totals = make_bounding_optics(index[0], absorption), np.zeros((2, 2))
    trace_to_detectors(1, np.array([0, 0, 100, max_order]), scene, optics, totals)
    expected = 0.5 / math.pi if max_order == 1 else 0.0
    assert detectors.sums[ABOVE, 0, 0] / 100 == pytest.approx(expected)


def test_lobes_too_narrow_for_the_expansion_are_reported():
    layer = splits.ParticleLayer(
        optical_thickness=1.0, asymmetry=0.9, single_scattering_albedo=1.0, ground=None
    )
    ds = splits.goniophotometer(layer, NM, 0.0, target="btdf")
    assert ds.attrs["stop_reason"] == "max_degree"
    bins = splits.goniophotometer(layer, NM, 0.0, rays=400_000, estimator="bins", n_bins=(60, 8))
    top = bins.btdf.isel(wavelength=0, polar_deg=0).mean("azimuth_deg")
    difference = abs(float(ds.btdf.isel(wavelength=0, polar_deg=0)[0] - top))
    assert difference < 3.0 * float(ds.btdf_stderr.isel(wavelength=0, polar_deg=0)[0])


REFERENCE = Path(__file__).with_name("reference")
compiled = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="millions of rays")


def make_layer(row: pd.Series) -> splits.ParticleLayer:
    """Return the layer of a row of plane_parallel.csv."""
    return splits.ParticleLayer(
        optical_thickness=row.tau,
        single_scattering_albedo=row.ssa,
        asymmetry=row.g,
        refractive_index=row.n,
        ground=None if row.n > 1.0 else row.lambert_bottom,
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
        ds = splits.spectrophotometer(
            make_layer(row), [550.0], incidence, max_stderr=max_stderr, seed=number
        )
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
        ground=None,
    )
    ds = splits.spectrophotometer(slab, [550.0], 0.0, max_stderr=2e-4)
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
            ground=bottom,
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
