"""Radiation profiles of particle layers, alone and in stacks, and of semi-infinite media."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z
from test_layer_exact import REFERENCE, make_layer

import splits
from splits.simulation.deep_medium import effective_mean_free_path

pytestmark = pytest.mark.long

pd = pytest.importorskip("pandas")
ROUGH = {"rms_height_m": 0.01, "wave_number_per_m": 10.0, "correlation": "gaussian"}
HAZE = splits.ParticleLayer(2.0, 0.95, 0.6, 1.33, None, depth_m=0.01)
STACK = splits.Stack([HAZE, splits.Snow(depth_m=0.01)], ground=0.4)
LAYERS = {
    "over a bottom": splits.ParticleLayer(),
    "over a black bottom": splits.ParticleLayer(bottom_albedo=0.0),
    "open below": splits.ParticleLayer(4.0, 0.9, 0.5, 1.0, None),
    "black particles": splits.ParticleLayer(1.0, 0.0, 0.0, 1.2),
    "semi-infinite": splits.ParticleLayer(math.inf, 0.95),
    "rough": splits.ParticleLayer(2.0, 0.9, surface=ROUGH),
    "polarized": splits.ParticleLayer(2.0, phase_function="rayleigh", polarized=True),
}
DEEP_SNOW = {"specific_surface_area_m2_kg": 20, "density_kg_m3": 300}


def net_flux(ds):
    return ds.downward_irradiance - ds.upward_irradiance


@NEEDS_JIT
@pytest.mark.parametrize("name", LAYERS)
def test_particle_layers_conserve_energy_and_match_reflectance(name):
    layer = LAYERS[name]
    ds = splits.irradiance_profile(layer, [500.0], [0.1, 0.4, 0.8], 30.0, 0.01)
    spectrum = splits.spectrophotometer(layer, [500.0], 30.0, 0.004, seed=2)
    reflected, absorbed = ds.upward_irradiance[0, 0], ds.absorptance[0].sum()
    transmitted = (
        net_flux(ds)[0, -1] if ds.sizes["interval"] == 4 and name != "semi-infinite" else 0.0
    )
    np.testing.assert_allclose(reflected + absorbed + transmitted, 1.0, atol=1e-12)
    of_matrix = ds.absorptance_of_material.sel(material="matrix")
    np.testing.assert_allclose(of_matrix, ds.absorptance, atol=1e-6)
    error = np.hypot(ds.upward_irradiance_stderr[0, 0], spectrum.reflectance_stderr[0])
    judge_z(np.array([(reflected - spectrum.reflectance[0]) / error]), bound_added=True)


@NEEDS_JIT
@pytest.mark.parametrize("error", [0.01, pytest.param(0.003, marks=pytest.mark.long)])
def test_particle_layers_agree_with_exact_fluxes(error):
    """The references are discrete ordinates and adding-doubling: reference/plane_parallel.csv."""
    table = pd.read_csv(REFERENCE / "plane_parallel.csv", comment="#")
    table = table[np.isfinite(table.tau) & (table.tau <= 8.0)].iloc[::3]
    z = []
    for number, (_, row) in enumerate(table.iterrows()):
        incidence = float(np.degrees(np.arccos(row.mu0)))
        ds = splits.irradiance_profile(make_layer(row), [550.0], [0.5], incidence, error, number)
        down = float(row["T"])
        for name, index, exact in (("upward", 0, row.R), ("downward", -1, down)):
            value, stderr = (
                float(ds[f"{name}_irradiance{end}"][0, index]) for end in ("", "_stderr")
            )
            z.append((value - exact) / math.hypot(stderr, row.est_err))
    judge_z(np.array(z), independent=len(table), bound_added=True)


@NEEDS_JIT
@pytest.mark.parametrize("error", [0.01, pytest.param(0.002, marks=pytest.mark.long)])
def test_stacked_particle_layers_agree_with_discrete_ordinates(error):
    """Two layers over a ground agree at depths within both layers."""
    pydisort = pytest.importorskip("PythonicDISORT").pydisort
    streams, mu = 32, 0.5
    layers = [(1.5, 0.95, 0.6), (3.0, 0.8, 0.2)]
    ground = 0.3
    stack = splits.Stack(
        [splits.ParticleLayer(tau, ssa, g, 1.0, None, depth_m=tau) for tau, ssa, g in layers],
        ground,
    )
    depths = np.array([0.3, 1.0, 1.5, 2.0, 3.0, 4.2])
    ds = splits.irradiance_profile(stack, [500.0], depths, 60.0, error)
    legendre = np.array([[g**n for n in range(streams + 1)] for *_, g in layers])
    _, up, down, *_ = pydisort(
        np.cumsum([tau for tau, *_ in layers]), np.array([ssa for _, ssa, _ in layers]), streams,
        legendre, mu, 1.0 / mu, 0.0, only_flux=True, f_arr=legendre[:, streams],
        BDRF_Fourier_modes=[ground],
    )  # fmt: skip
    boundaries = np.array([0.0, *depths, 4.5])
    exact = [up(boundaries), np.sum(down(boundaries), axis=0)]
    z = []
    for fluxes, name in zip(exact, ("upward_irradiance", "downward_irradiance"), strict=True):
        difference, stderr = ds[name][0].values - fluxes, ds[f"{name}_stderr"][0].values
        z.append(difference[stderr > 1e-9] / stderr[stderr > 1e-9])
    absorbed = -np.diff(exact[1] - exact[0])
    z.append((ds.absorptance[0].values - absorbed) / ds.absorptance_stderr[0].values)
    judge_z(np.concatenate(z), independent=3, bound_added=True)


@NEEDS_JIT
def test_depth_planes_do_not_change_the_spectrum():
    """Materials absorb in their own layer only, and totals agree with the spectrophotometer."""
    ds = splits.irradiance_profile(STACK, [500.0, 900.0], [0.004, 0.01, 0.015], 20.0, 0.01)
    spectrum = splits.spectrophotometer(STACK, [500.0, 900.0], 20.0, 0.005, seed=3)
    absorbed = ds.absorptance.sum("interval")
    z = [
        (actual - spectrum[name]).values / np.hypot(error, spectrum[f"{name}_stderr"]).values
        for actual, error, name in (
            (ds.upward_irradiance[:, 0], ds.upward_irradiance_stderr[:, 0], "reflectance"),
            (net_flux(ds)[:, -1], ds.downward_irradiance_stderr[:, -1], "transmittance"),
        )
    ]
    judge_z(np.array(z), independent=1, bound_added=True)
    np.testing.assert_allclose(net_flux(ds)[:, 0] - net_flux(ds)[:, -1], absorbed, atol=1e-12)
    upper = ds.absorptance_of_material.isel(interval=slice(2))
    matrix = upper.sel(material="layers.0.matrix")
    np.testing.assert_allclose(matrix, upper.sum("material"), atol=1e-9)


@NEEDS_JIT
@pytest.mark.parametrize("error", [0.04, pytest.param(0.01, marks=pytest.mark.long)])
def test_semi_infinite_snowpack_agrees_with_a_deep_one(error):
    wavelengths, depths = [500.0, 900.0, 1100.0], [0.005, 0.02, 0.04]
    semi_infinite, deep = (
        splits.irradiance_profile(
            splits.Snow.natural(**DEEP_SNOW, depth_m=depth), wavelengths, depths,
            "diffuse", error, seed, solver="monte_carlo",
        )
        for seed, depth in ((1, math.inf), (2, 0.5))
    )  # fmt: skip
    assert semi_infinite.depth.values.tolist() == [0.0, *depths]
    assert semi_infinite.interval_bottom[-1] == math.inf
    np.testing.assert_allclose(
        semi_infinite.upward_irradiance[:, 0] + semi_infinite.absorptance.sum("interval"),
        1.0,
        atol=1e-9,
    )
    by_material = semi_infinite.absorptance_of_material.sum("material")
    np.testing.assert_allclose(by_material, semi_infinite.absorptance, atol=1e-9)
    z = []
    for name in ("downward_irradiance", "upward_irradiance", "absorptance"):
        one, other = (
            semi_infinite[name].values,
            deep[name].values[:, : semi_infinite[name].shape[1]],
        )
        errors = [ds[f"{name}_stderr"].values[:, : one.shape[1]] for ds in (semi_infinite, deep)]
        error_of_difference = np.hypot(*errors)
        z.append(
            (
                (one - other)[error_of_difference > 1e-9]
                / error_of_difference[error_of_difference > 1e-9]
            ).ravel()
        )
    judge_z(np.concatenate(z), independent=3, bound_added=True)


@NEEDS_JIT
@pytest.mark.parametrize("seeds", [24, pytest.param(100, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    ("medium", "depths"),
    [
        (LAYERS["over a bottom"], [0.2, 0.6]),
        (STACK, [0.005, 0.015]),
        (splits.Snow.natural(**DEEP_SNOW, depth_m=math.inf), [0.005, 0.02]),
    ],
    ids=["layer", "stack", "semi-infinite"],
)
def test_errors_of_profiles_agree_with_scatter(medium, depths, seeds):
    runs = [
        splits.irradiance_profile(
            medium,
            [700.0],
            depths,
            40.0,
            0.03,
            seed,
            target="absorptance",
            threads=1,
            solver="monte_carlo",
        )
        for seed in range(seeds)
    ]
    z = []
    for name in ("downward_irradiance", "upward_irradiance", "absorptance"):
        values = np.array([run[name].values[0] for run in runs])
        stderrs = np.array([run[f"{name}_stderr"].values[0] for run in runs])
        varies = values.std(axis=0) > 1e-9
        deviations = (values - values.mean(axis=0))[:, varies] / np.sqrt(1.0 - 1.0 / seeds)
        z.append(deviations / np.sqrt((stderrs[:, varies] ** 2).mean(axis=0)))
    all_z = np.concatenate(z, axis=1)
    judge_z(all_z, independent=seeds, bound_added=True)
    assert np.sqrt((all_z**2).mean()) > 0.6


@NEEDS_JIT
@pytest.mark.parametrize("albedo", [0.9, 1.0])
def test_unbounded_interval_is_saved_and_loaded(albedo, tmp_path):
    ds = splits.irradiance_profile(
        splits.ParticleLayer(math.inf, albedo, refractive_index=1.0), 500.0, [1.0, 8.0]
    )
    splits.save(ds, tmp_path / "inside.nc")
    assert splits.load(tmp_path / "inside.nc").equals(ds)
    # Without absorption the actinic flux is constant far from the top.
    deepest, above = ds.actinic_flux[0, -1], ds.actinic_flux[0, -2]
    assert deepest == 0.0 if albedo < 1.0 else deepest == pytest.approx(float(above), rel=0.1)


@NEEDS_JIT
def test_deep_fluxes_decay_by_asymptotic_theory():
    """Fluxes decay as exp(-κz), and their ratio is that of diffusion theory."""
    snow = splits.Snow.natural(**DEEP_SNOW, depth_m=math.inf)
    optics = splits.single_scattering(
        splits.Snow.natural(**DEEP_SNOW, depth_m=1.0), [900.0], rays=60_000
    )
    step = effective_mean_free_path(optics)[0]
    loss = 1.0 - optics.single_scattering_albedo.values[0]
    diffusion = step / (3.0 * (1.0 - optics.asymmetry_parameter.values[0] + loss))
    rate = math.sqrt(loss / step / diffusion)
    depths = np.array([1.0, 2.0]) / rate
    ds = splits.irradiance_profile(snow, [900.0], depths, "diffuse", 0.008, solver="monte_carlo")
    down, up = ds.downward_irradiance[0, 1:].values, ds.upward_irradiance[0, 1:].values
    relative = np.hypot(*(ds.downward_irradiance_stderr[0, 1:].values / down))
    # Diffusion theory is accurate to first order in κD, here to a few per cent.
    assert math.log(down[0] / down[1]) == pytest.approx(1.0, abs=2.6 * relative + 0.03)
    asymptotic = (1.0 - 2.0 * rate * diffusion) / (1.0 + 2.0 * rate * diffusion)
    np.testing.assert_allclose(up / down, asymptotic, atol=0.02)


@pytest.mark.parametrize(
    ("medium", "depths", "message"),
    [
        (splits.ParticleLayer(opaque=True), [0.5], r"opaque.*must be false \(all light is"),
        (LAYERS["rough"], [0.01], r"depth_m = 0.01: must be at least 0.08 m"),
        (splits.Snow(depth_m=math.inf, pores={"oil": 0.1}, refractive_index={"oil": 1.4}), [0.1],
         r"finite where pores hold other media"),
    ],
)  # fmt: skip
def test_unsupported_profiles_are_rejected(medium, depths, message):
    with pytest.raises(ValueError, match=message):
        splits.irradiance_profile(medium, 500.0, depths)
