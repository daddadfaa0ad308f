"""Light inside layers of particles, alone and in stacks, and inside packs without end."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z
from test_layer_exact import REFERENCE, layer_of

import splits
from splits.simulation.diffusion import effective_mean_free_path

pd = pytest.importorskip("pandas")
ROUGH = {"rms_height_m": 0.01, "wave_number_per_m": 10.0, "correlation": "gaussian"}
HAZE = splits.ParticleLayer(2.0, 0.95, 0.6, 1.33, None, depth_m=0.01)
STACK = splits.Stack([HAZE, splits.Snow(depth_m=0.01)], ground=0.4)
LAYERS = {
    "over a bottom": splits.ParticleLayer(),
    "over a black bottom": splits.ParticleLayer(bottom_albedo=0.0),
    "open below": splits.ParticleLayer(4.0, 0.9, 0.5, 1.0, None),
    "black particles": splits.ParticleLayer(1.0, 0.0, 0.0, 1.2),
    "without end": splits.ParticleLayer(math.inf, 0.95),
    "rough": splits.ParticleLayer(2.0, 0.9, surface=ROUGH),
}
ENDLESS = {"specific_surface_area_m2_kg": 20, "density_kg_m3": 300}


def net(ds):
    return ds.downward_irradiance - ds.upward_irradiance


@NEEDS_JIT
@pytest.mark.parametrize("name", LAYERS)
def test_layers_alone_balance_and_reflect_as_they_do(name):
    layer = LAYERS[name]
    ds = splits.irradiance_profile(layer, [500.0], [0.1, 0.4, 0.8], 30.0, 0.01)
    whole = splits.spectrophotometer(layer, [500.0], 30.0, 0.004, seed=2)
    reflected, absorbed = ds.upward_irradiance[0, 0], ds.absorptance[0].sum()
    through = net(ds)[0, -1] if ds.sizes["interval"] == 4 and name != "without end" else 0.0
    np.testing.assert_allclose(reflected + absorbed + through, 1.0, atol=1e-12)
    of_matrix = ds.absorptance_of_material.sel(material="matrix")
    np.testing.assert_allclose(of_matrix, ds.absorptance, atol=1e-6)
    error = np.hypot(ds.upward_irradiance_stderr[0, 0], whole.reflectance_stderr[0])
    judge_z(np.array([(reflected - whole.reflectance[0]) / error]), bound_added=True)


@NEEDS_JIT
@pytest.mark.parametrize("error", [0.01, pytest.param(0.003, marks=pytest.mark.long)])
def test_layers_alone_let_through_what_is_exact(error):
    """Discrete ordinates and adding-doubling, see reference/plane_parallel.csv."""
    table = pd.read_csv(REFERENCE / "plane_parallel.csv", comment="#")
    table = table[np.isfinite(table.tau) & (table.tau <= 8.0)].iloc[::3]
    z = []
    for number, (_, row) in enumerate(table.iterrows()):
        incidence = float(np.degrees(np.arccos(row.mu0)))
        ds = splits.irradiance_profile(layer_of(row), [550.0], [0.5], incidence, error, number)
        down = float(row["T"])
        for name, place, exact in (("upward", 0, row.R), ("downward", -1, down)):
            value, stderr = (
                float(ds[f"{name}_irradiance{end}"][0, place]) for end in ("", "_stderr")
            )
            z.append((value - exact) / math.hypot(stderr, row.est_err))
    judge_z(np.array(z), independent=len(table), bound_added=True)


@NEEDS_JIT
@pytest.mark.parametrize("error", [0.01, pytest.param(0.002, marks=pytest.mark.long)])
def test_layers_of_particles_have_the_fluxes_of_discrete_ordinates(error):
    """Two layers over a ground, at depths within both."""
    pydisort = pytest.importorskip("PythonicDISORT").pydisort
    streams, mu = 32, 0.5
    layers = [(1.5, 0.95, 0.6), (3.0, 0.8, 0.2)]
    ground = 0.3
    stack = splits.Stack(
        [splits.ParticleLayer(tau, ssa, g, 1.0, None, depth_m=tau) for tau, ssa, g in layers],
        ground,
    )
    at = np.array([0.3, 1.0, 1.5, 2.0, 3.0, 4.2])
    ds = splits.irradiance_profile(stack, [500.0], at, 60.0, error)
    legendre = np.array([[g**n for n in range(streams + 1)] for *_, g in layers])
    _, up, down, *_ = pydisort(
        np.cumsum([tau for tau, *_ in layers]), np.array([ssa for _, ssa, _ in layers]), streams,
        legendre, mu, 1.0 / mu, 0.0, only_flux=True, f_arr=legendre[:, streams],
        BDRF_Fourier_modes=[ground],
    )  # fmt: skip
    every = np.array([0.0, *at, 4.5])
    exact = [up(every), np.sum(down(every), axis=0)]
    z = []
    for fluxes, name in zip(exact, ("upward_irradiance", "downward_irradiance"), strict=True):
        off, stderr = ds[name][0].values - fluxes, ds[f"{name}_stderr"][0].values
        z.append(off[stderr > 1e-9] / stderr[stderr > 1e-9])
    absorbed = -np.diff(exact[1] - exact[0])
    z.append((ds.absorptance[0].values - absorbed) / ds.absorptance_stderr[0].values)
    judge_z(np.concatenate(z), independent=3, bound_added=True)


@NEEDS_JIT
def test_a_layer_of_particles_cut_by_planes_is_the_same():
    """Each material absorbs in its own layer, and the whole is what the spectrum says."""
    ds = splits.irradiance_profile(STACK, [500.0, 900.0], [0.004, 0.01, 0.015], 20.0, 0.01)
    whole = splits.spectrophotometer(STACK, [500.0, 900.0], 20.0, 0.005, seed=3)
    absorbed = ds.absorptance.sum("interval")
    z = [
        (found - whole[name]).values / np.hypot(error, whole[f"{name}_stderr"]).values
        for found, error, name in (
            (ds.upward_irradiance[:, 0], ds.upward_irradiance_stderr[:, 0], "reflectance"),
            (net(ds)[:, -1], ds.downward_irradiance_stderr[:, -1], "transmittance"),
        )
    ]
    judge_z(np.array(z), independent=1, bound_added=True)
    np.testing.assert_allclose(net(ds)[:, 0] - net(ds)[:, -1], absorbed, atol=1e-12)
    upper = ds.absorptance_of_material.isel(interval=slice(2))
    matrix = upper.sel(material="layers.0.matrix")
    np.testing.assert_allclose(matrix, upper.sum("material"), atol=1e-9)


@NEEDS_JIT
@pytest.mark.parametrize("error", [0.04, pytest.param(0.01, marks=pytest.mark.long)])
def test_a_pack_without_end_is_a_very_deep_one(error):
    wavelengths, depths = [500.0, 900.0, 1100.0], [0.005, 0.02, 0.04]
    endless, deep = (
        splits.irradiance_profile(
            splits.Snow.natural(**ENDLESS, depth_m=depth), wavelengths, depths,
            "diffuse", error, seed,
        )
        for seed, depth in ((1, math.inf), (2, 0.5))
    )  # fmt: skip
    assert endless.depth.values.tolist() == [0.0, *depths]
    assert endless.interval_bottom[-1] == math.inf
    np.testing.assert_allclose(
        endless.upward_irradiance[:, 0] + endless.absorptance.sum("interval"), 1.0, atol=1e-9
    )
    by_material = endless.absorptance_of_material.sum("material")
    np.testing.assert_allclose(by_material, endless.absorptance, atol=1e-9)
    z = []
    for name in ("downward_irradiance", "upward_irradiance", "absorptance"):
        one, other = endless[name].values, deep[name].values[:, : endless[name].shape[1]]
        errors = [ds[f"{name}_stderr"].values[:, : one.shape[1]] for ds in (endless, deep)]
        both = np.hypot(*errors)
        z.append(((one - other)[both > 1e-9] / both[both > 1e-9]).ravel())
    judge_z(np.concatenate(z), independent=3, bound_added=True)


@NEEDS_JIT
@pytest.mark.parametrize("seeds", [24, pytest.param(100, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    ("medium", "depths"),
    [
        (LAYERS["over a bottom"], [0.2, 0.6]),
        (STACK, [0.005, 0.015]),
        (splits.Snow.natural(**ENDLESS, depth_m=math.inf), [0.005, 0.02]),
    ],
    ids=["layer", "stack", "without end"],
)
def test_profiles_have_the_errors_that_seeds_scatter_by(medium, depths, seeds):
    runs = [
        splits.irradiance_profile(
            medium, [700.0], depths, 40.0, 0.03, seed, target="absorptance", threads=1
        )
        for seed in range(seeds)
    ]
    z = []
    for name in ("downward_irradiance", "upward_irradiance", "absorptance"):
        values = np.array([run[name].values[0] for run in runs])
        stated = np.array([run[f"{name}_stderr"].values[0] for run in runs])
        seen = values.std(axis=0) > 1e-9
        off = (values - values.mean(axis=0))[:, seen] / np.sqrt(1.0 - 1.0 / seeds)
        z.append(off / np.sqrt((stated[:, seen] ** 2).mean(axis=0)))
    every = np.concatenate(z, axis=1)
    judge_z(every, independent=seeds, bound_added=True)
    assert np.sqrt((every**2).mean()) > 0.6


@NEEDS_JIT
@pytest.mark.parametrize("albedo", [0.9, 1.0])
def test_an_interval_without_end_is_saved(albedo, tmp_path):
    ds = splits.irradiance_profile(
        splits.ParticleLayer(math.inf, albedo, refractive_index=1.0), 500.0, [1.0, 8.0]
    )
    splits.save(ds, tmp_path / "inside.nc")
    assert splits.load(tmp_path / "inside.nc").equals(ds)
    # Where nothing absorbs, light is the same everywhere far from the top.
    last, above = ds.actinic_flux[0, -1], ds.actinic_flux[0, -2]
    assert last == 0.0 if albedo < 1.0 else last == pytest.approx(float(above), rel=0.1)


@NEEDS_JIT
def test_light_deep_in_a_pack_without_end_decays_as_asymptotic_theory_has_it():
    """By exp(-κz), and as much upwards as an endless pack sends back of such light."""
    snow = splits.Snow.natural(**ENDLESS, depth_m=math.inf)
    optics = splits.single_scattering(
        splits.Snow.natural(**ENDLESS, depth_m=1.0), [900.0], rays=60_000
    )
    step = effective_mean_free_path(optics)[0]
    loss = 1.0 - optics.single_scattering_albedo.values[0]
    diffusion = step / (3.0 * (1.0 - optics.asymmetry_parameter.values[0] + loss))
    rate = math.sqrt(loss / step / diffusion)
    depths = np.array([1.0, 2.0]) / rate
    ds = splits.irradiance_profile(snow, [900.0], depths, "diffuse", 0.008)
    down, up = ds.downward_irradiance[0, 1:].values, ds.upward_irradiance[0, 1:].values
    relative = np.hypot(*(ds.downward_irradiance_stderr[0, 1:].values / down))
    # Diffusion holds to first order in κD: to a few per cent here.
    assert math.log(down[0] / down[1]) == pytest.approx(1.0, abs=2.6 * relative + 0.03)
    asymptotic = (1.0 - 2.0 * rate * diffusion) / (1.0 + 2.0 * rate * diffusion)
    np.testing.assert_allclose(up / down, asymptotic, atol=0.02)


@pytest.mark.parametrize(
    ("medium", "depths", "message"),
    [
        (splits.ParticleLayer(polarized=True), [0.5], r"polarized = True: must be false"),
        (splits.ParticleLayer(opaque=True), [0.5], r"opaque = True: must be false"),
        (LAYERS["rough"], [0.01], r"depth_m = 0.01: must be at least 0.08 m"),
        (splits.Snow(depth_m=math.inf, pores={"oil": 0.1}, refractive_index={"oil": 1.4}), [0.1],
         r"finite where pores hold other media"),
    ],
)  # fmt: skip
def test_profiles_that_cannot_be_had_say_so(medium, depths, message):
    with pytest.raises(ValueError, match=message):
        splits.irradiance_profile(medium, 500.0, depths)
