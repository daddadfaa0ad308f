"""Media and grid points that share paths: reproducibility, independent runs, derivatives."""

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results, compute_z_bound, judge_scatter, judge_z

import splits
from splits.core.validation import InvalidValue
from splits.experiments.config.sections import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.experiments.run import run, simulate_points

WAVELENGTHS = np.array([400.0, 450.0, 550.0, 700.0, 850.0, 1000.0])
SOOT = "impurities_ng_g.black_carbon"
CONCENTRATIONS = (0.0, *np.geomspace(5.0, 5000.0, 19))
SETTINGS = {
    "thin over soil": {"depth_m": 0.05, "ground": 0.3},
    "open below": {"depth_m": 0.05},
    "deep": {},
    "in pores": {"depth_m": 0.05, "impurities_in": "pores"},
}


def make_snow(soot: float, **settings) -> splits.Snow:
    """Return natural snow with a concentration of black carbon (ng/g)."""
    given = {"specific_surface_area_m2_kg": 20.0, "density_kg_m3": 250.0} | settings
    return splits.Snow.natural(**given, impurities_ng_g={"black_carbon": soot})


def make_polluted_snow(amounts, **settings) -> dict[str, splits.Snow]:
    """Return snow of several concentrations, by name."""
    return {f"{soot:g}": make_snow(soot, **settings) for soot in amounts}


@NEEDS_JIT
@pytest.mark.parametrize("kernel", ["vectorized", "scalar"])
@pytest.mark.parametrize("setting", ["thin over soil", "in pores", "deep"])
def test_results_are_independent_of_other_media_in_a_run(setting, kernel):
    """Twenty concentrations in one run equal pairs of clean snow and one concentration."""
    run_settings = {"max_stderr": 0.5, "kernel": kernel, "seed": 3}
    together = splits.spectrophotometer(
        make_polluted_snow(CONCENTRATIONS, **SETTINGS[setting]),
        WAVELENGTHS,
        **run_settings,
        solver="monte_carlo",
    )
    for name, soot in zip(together.medium.values, CONCENTRATIONS, strict=True):
        pair = splits.spectrophotometer(
            make_polluted_snow((0.0, soot), **SETTINGS[setting]),
            WAVELENGTHS,
            **run_settings,
            solver="monte_carlo",
        )
        assert pair.rays == together.rays
        for quantity in ("reflectance", "transmittance", "absorptance"):
            one = pair[quantity].sel(medium=f"{soot:g}").values
            assert np.array_equal(together[quantity].sel(medium=name).values, one), (name, quantity)


@NEEDS_JIT
@pytest.mark.parametrize("error", [0.005, pytest.param(0.003, marks=pytest.mark.long)])
@pytest.mark.parametrize("setting", SETTINGS)
def test_shared_paths_agree_with_single_runs(setting, error):
    """Each run has its own seed; media that share paths are correlated, so they count as one.

    At 0.003 a deviation of 0.04 of one reflectance, or of 0.009 of all, is detected with 99 %
    probability: the shared run has the smaller error, so common deviations are more significant.
    """
    settings = SETTINGS[setting]
    together = splits.spectrophotometer(
        make_polluted_snow(CONCENTRATIONS, **settings),
        WAVELENGTHS,
        max_stderr=error,
        solver="monte_carlo",
    )
    z = []
    for number, (name, medium) in enumerate(make_polluted_snow(CONCENTRATIONS, **settings).items()):
        single = splits.spectrophotometer(
            medium, WAVELENGTHS, max_stderr=2.0 * error, seed=100 + number, solver="monte_carlo"
        )
        z.append(compare_results(together.sel(medium=name), single, "reflectance"))
    judge_z(np.array(z), setting, independent=len(WAVELENGTHS), bound_added=True)


SEEDS = 6


def compute_jacobian_difference(run, pair, quantity, number, lower, upper, step):
    """Return a derivative minus the finite difference of two media, and its standard error."""
    values, batches = pair[quantity], pair[f"{quantity}_batches"]
    difference = (values.sel(medium=upper) - values.sel(medium=lower)) / step
    error = np.sqrt(
        (((batches.sel(medium=upper) - batches.sel(medium=lower)) / step) ** 2).sum("batch")
    )
    stderr = run[f"{quantity}_jacobian_stderr"][number].values
    slope = run[f"{quantity}_jacobian"][number].values
    return slope - difference.values, np.hypot(stderr, error.values)


@NEEDS_JIT
@pytest.mark.parametrize("error", [0.004, pytest.param(0.002, marks=pytest.mark.long)])
@pytest.mark.parametrize("setting", SETTINGS)
def test_derivatives_agree_with_differences_of_shared_paths(setting, error):
    """Derivatives to black carbon and algae agree with finite differences of other paths."""
    settings = SETTINGS[setting]
    media = make_polluted_snow((190.0, 210.0), **settings)
    media |= {
        f"algae {cells:g}": splits.Snow.natural(
            specific_surface_area_m2_kg=20.0, density_kg_m3=250.0, **settings,
            impurities_ng_g={"black_carbon": 200.0}, algae_cells_ml={"snow_algae": cells},
        )
        for cells in (0.0, 40.0)
    }  # fmt: skip
    bands = WAVELENGTHS[WAVELENGTHS < 750.0]
    differences, variances = [], []
    # Rare long paths make errors of single runs uneven, so means over several are tested.
    for seed in range(SEEDS):
        run = splits.spectrophotometer(
            make_snow(200.0, **settings), bands, max_stderr=error, seed=100 + seed,
            jacobian=[SOOT, "algae_cells_ml.snow_algae"], solver="monte_carlo",
        )  # fmt: skip
        pair = splits.spectrophotometer(
            media, bands, max_stderr=error, seed=200 + seed, solver="monte_carlo"
        )
        comparisons = [
            compute_jacobian_difference(run, pair, quantity, number, *ends)
            for quantity in ("reflectance", "transmittance")
            if quantity == "reflectance" or float(run.transmittance.max()) > 1e-3
            for number, ends in enumerate([("190", "210", 20.0), ("algae 0", "algae 40", 40.0)])
        ]
        differences.append([difference for difference, _ in comparisons])
        variances.append([stderr**2 for _, stderr in comparisons])
    z = np.mean(differences, axis=0) / np.sqrt(np.mean(variances, axis=0) / SEEDS)
    judge_z(z, setting, independent=len(bands), bound_added=True)


TRANSPARENT = {
    "specific_surface_area_m2_kg": 20.0,
    "refractive_index": {"ice": 1.31},
    "depth_m": 3.0,
}
"""Snow so deep that it is truncated, without absorption."""
GREY = {"specific_surface_area_m2_kg": 20.0, "refractive_index": {"ice": "warren_brandt_2008"}}


@NEEDS_JIT
@pytest.mark.parametrize(
    ("settings", "amount"), [(TRANSPARENT, 1e-3), (GREY | {"impurities_in": "pores"}, 1e-3)]
)
def test_derivatives_in_nonabsorbing_host_media(settings, amount):
    """The derivative equals a difference of the same paths, also below the truncation depth."""
    clean, dirty = (
        splits.Snow.natural(**settings, impurities_ng_g={"black_carbon": ng})
        for ng in (0.0, amount)
    )
    run_settings = {"max_stderr": 0.01, "seed": 5}
    run = splits.spectrophotometer(
        clean, [400.0, 500.0], jacobian=[SOOT], **run_settings, solver="monte_carlo"
    )
    both = splits.spectrophotometer(
        {"clean": clean, "dirty": dirty}, [400.0, 500.0], **run_settings, solver="monte_carlo"
    )
    for quantity in ("reflectance", "transmittance"):
        slope = run[f"{quantity}_jacobian"][0].values
        change = (both[quantity][1] - both[quantity][0]).values / amount
        np.testing.assert_allclose(slope, change, rtol=0.02, atol=1e-9)


@NEEDS_JIT
def test_errors_of_derivatives_agree_with_scatter():
    """Stated errors agree with the scatter of forty seeds; values of a run count as one."""
    runs = [
        splits.spectrophotometer(
            make_snow(100.0, depth_m=0.05),
            [450.0, 700.0],
            max_stderr=0.02,
            seed=seed,
            jacobian=[SOOT],
            solver="monte_carlo",
        )
        for seed in range(40)
    ]
    slopes = np.array([run.reflectance_jacobian.values[0] for run in runs])
    batches = np.array([run.reflectance_jacobian_batches.values[:, 0] for run in runs])
    judge_scatter(slopes, np.sqrt((batches**2).sum(axis=1)))


@NEEDS_JIT
def test_derivatives_of_single_layers_of_a_stack():
    """Derivatives to the soot of two layers add up to the derivative to that of both."""
    stack = splits.Stack([make_snow(50.0, depth_m=0.02), make_snow(50.0, depth_m=0.1)], ground=0.2)
    names = [f"layers.{number}.{SOOT}" for number in (0, 1)]
    run = splits.spectrophotometer(
        stack, [450.0, 600.0], max_stderr=0.005, jacobian=names, solver="monte_carlo"
    )
    assert list(run.parameter.values) == names
    top, bottom = run.reflectance_jacobian.values
    error = run.reflectance_jacobian_stderr.values
    assert (top < -5.0 * error[0]).all()
    assert (bottom < -5.0 * error[1]).all()
    stacks = [
        splits.Stack([make_snow(s, depth_m=0.02), make_snow(s, depth_m=0.1)], ground=0.2)
        for s in (40.0, 60.0)
    ]
    pair = splits.spectrophotometer(
        dict(zip("ab", stacks, strict=True)), [450.0, 600.0], max_stderr=0.005, solver="monte_carlo"
    )
    difference = (pair.reflectance[1] - pair.reflectance[0]).values / 20.0
    batch_differences = (
        pair.reflectance_batches[:, 1] - pair.reflectance_batches[:, 0]
    ).values / 20.0
    noise = np.sqrt((batch_differences**2).sum(axis=0) + error[0] ** 2 + error[1] ** 2)
    judge_z((top + bottom - difference) / noise, independent=1, bound_added=True)


def test_grounds_of_several_albedos_share_paths():
    """The albedo of a ground acts on weights at a reflection, as soot does along a segment."""
    media = {f"{a}": make_snow(0.0, depth_m=0.01, ground=a) for a in (0.2, 0.8)}
    run = splits.spectrophotometer(media, [500.0, 900.0], max_stderr=0.05, solver="monte_carlo")
    assert (run.reflectance[1] > run.reflectance[0]).all()
    assert run.snow_black_carbon_ng_g == 0.0


BASE = make_snow(0.0, depth_m=0.05)
WRONG = {
    "other grains": (
        {"a": BASE, "b": splits.Snow(depth_m=0.05)},
        r"medium\['b'\] = 'snow': must be",
    ),
    "other depth": ({"a": BASE, "b": make_snow(0.0, depth_m=0.1)}, r"medium\['b'\]"),
    "a ground": ({"a": BASE, "b": make_snow(0.0, depth_m=0.05, ground=0.5)}, r"medium\['b'\]"),
    "another kind": ({"a": BASE, "b": splits.Sand(depth_m=0.05)}, r"medium\['b'\] = 'sand'"),
    "a particle layer": (
        {"a": BASE, "b": splits.ParticleLayer(optical_thickness=1)},
        r"\['b'\] = 'particle_layer'",
    ),
    "other particles": (
        {name: splits.ParticleLayer(asymmetry=g) for name, g in (("a", 0.5), ("b", 0.6))},
        r"medium\['b'\]",
    ),
    "another bottom": (
        {name: splits.ParticleLayer(ground=x) for name, x in (("a", 0.5), ("b", None))},
        r"medium\['b'\]",
    ),
    "another index": (
        {name: splits.ParticleLayer(refractive_index=n) for name, n in (("a", 1.3), ("b", 1.4))},
        r"medium\['b'\]",
    ),
    "none": ({}, "at least one"),
    "a list": ([BASE], r"must be splits.Snow"),
}


@pytest.mark.parametrize("name", WRONG)
def test_media_that_do_not_share_paths_are_invalid(name):
    media, message = WRONG[name]
    with pytest.raises(InvalidValue, match=message):
        splits.spectrophotometer(media, [500.0], max_stderr=0.1, solver="monte_carlo")


STACK = splits.Stack([BASE, BASE])
UNKNOWN = {
    "unknown kind": (BASE, ["impurities_ng_g.soot"], "black_carbon"),
    "unknown key": (BASE, ["optical_radius"], "did you mean optical_radius_um"),
    "a range": (BASE, ["grain_size_um"], "unknown key"),
    "an open ground": (BASE, ["ground"], "unknown key"),
    "infinite depth": (splits.Snow.natural(optical_radius_um=100), ["depth_m"], "finite value"),
    "diffuse": (BASE, ["incidence_deg"], "belongs to a beam"),
    "a layer of no stack": (BASE, [f"layers.0.{SOOT}"], "not a stack"),
    "no layer": (STACK, [SOOT], r"layers.0 to layers.1"),
    "far layer": (STACK, [f"layers.2.{SOOT}"], r"layers.0 to layers.1"),
    "sand": (splits.Sand(), [SOOT], "with impurities"),
    "a layer": (splits.ParticleLayer(optical_thickness=1), [SOOT], "with impurities"),
    "twice": (BASE, [SOOT, SOOT], "named once"),
    "text": (BASE, SOOT, "a list of parameters"),
    "algae by mass": (BASE, ["impurities_ng_g.snow_algae"], "snow_algae"),
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_unknown_derivatives_are_rejected(name):
    medium, jacobian, message = UNKNOWN[name]
    with pytest.raises(InvalidValue, match=message):
        light = "diffuse" if "incidence_deg" in jacobian else 0.0
        splits.spectrophotometer(
            medium, [500.0], light, max_stderr=0.1, jacobian=jacobian, solver="monte_carlo"
        )


def test_derivatives_require_the_spectral_estimator():
    with pytest.raises(InvalidValue, match="left out for this estimator"):
        splits.spectrophotometer(BASE, [500.0], estimator="analog", jacobian=[SOOT])


@NEEDS_JIT
def test_deep_conservative_media_have_no_derivative():
    """Their reflectance falls with the root of the added absorption."""
    transparent = splits.Snow.natural(
        specific_surface_area_m2_kg=20, refractive_index={"ice": 1.31, "water": 1.33}
    )
    with pytest.raises(InvalidValue, match="where nothing absorbs"):
        splits.spectrophotometer(
            transparent, [500.0], max_stderr=0.01, jacobian=[SOOT], solver="monte_carlo"
        )


ERROR = 0.01
POINT_WAVELENGTHS = [500.0, 1030.0, 1300.0]
SIZES = [5.0, 20.0]
SOOT_AMOUNTS = [0.0, 200.0]


def make_config(**changes):
    return SimulationConfig.model_validate(
        {
            "name": "deep",
            "medium": {"kind": "natural_snow", "density_kg_m3": 300},
            "instrument": {"wavelength_nm": POINT_WAVELENGTHS, "solver": "monte_carlo"},
            "grid": {
                "specific_surface_area_m2_kg": SIZES,
                "incidence_deg": [0, 60],
                "impurities_ng_g.black_carbon": SOOT_AMOUNTS,
            },
            **changes,
        }
    )


ACCURACY = Accuracy(max_stderr=ERROR, relative_stderr=0.2)


@pytest.fixture(scope="module")
def shared_run():
    lines = []
    dataset = run(make_config(), ACCURACY, seed=5, threads=2, log=lines.append)
    return dataset, lines


@NEEDS_JIT
def test_paths_are_traced_once_per_incidence(shared_run):
    dataset, lines = shared_run
    assert lines[0] == "deep: 2 sets of paths for 8 points"
    rays = dataset.rays.values
    assert (rays == rays[0, :, 0][np.newaxis, :, np.newaxis]).all()
    assert dataset.attrs["rays"] == rays[0, :, 0].sum()
    assert dataset.attrs["max_stderr_reached"] <= ERROR


@NEEDS_JIT
def test_points_agree_with_single_runs(shared_run):
    dataset, _ = shared_run
    z = []
    for area in SIZES:
        for incidence in (0.0, 60.0):
            for soot in SOOT_AMOUNTS:
                snow = splits.Snow.natural(
                    specific_surface_area_m2_kg=area,
                    density_kg_m3=300,
                    impurities_ng_g={"black_carbon": soot} if soot else {},
                )
                single = splits.spectrophotometer(
                    snow,
                    POINT_WAVELENGTHS,
                    incidence,
                    max_stderr=ERROR / 3,
                    seed=77,
                    solver="monte_carlo",
                )
                shared = dataset.sel(
                    {"specific_surface_area_m2_kg": area, "impurities_ng_g.black_carbon": soot}
                ).isel(incidence_deg=int(incidence > 0))
                z += list(compare_results(shared, single, "reflectance"))
    z = np.array(z)
    # Points of one ensemble are correlated.
    print(f"{z.size} values against single runs: rms z {np.sqrt((z**2).mean()):.2f}")
    assert np.abs(z).max() < compute_z_bound(z.size)


@NEEDS_JIT
def test_single_point_equals_the_instrument(shared_run):
    snow = {"kind": "natural_snow", "density_kg_m3": 300, "specific_surface_area_m2_kg": 20}
    config = make_config(medium=snow, grid={"depth_m": [0.02, 0.05]})
    points, rays = simulate_points(config, ACCURACY, 5, 2, lambda line: None)
    medium = splits.Snow.natural(specific_surface_area_m2_kg=20, density_kg_m3=300, depth_m=0.05)
    reference = splits.spectrophotometer(
        medium, POINT_WAVELENGTHS, 0.0, max_stderr=ERROR, seed=5, solver="monte_carlo"
    )
    np.testing.assert_array_equal(points[1].reflectance, reference.reflectance)
    assert rays == sum(ds.attrs["rays"] for ds in points)


@NEEDS_JIT
def test_datasets_have_equal_structure_with_and_without_sharing(shared_run):
    (shared, *_), _ = simulate_points(make_config(), ACCURACY, 5, 2, lambda line: None)
    single = splits.spectrophotometer(
        splits.Snow.natural(specific_surface_area_m2_kg=5, density_kg_m3=300), POINT_WAVELENGTHS,
        max_stderr=ERROR, solver="monte_carlo",
    )  # fmt: skip
    assert set(shared.data_vars) == set(single.data_vars)
    attributes = [
        {key for key in dataset.attrs if not key.startswith("snow_")}
        for dataset in (shared, single)
    ]
    assert attributes[0] == attributes[1]
    for name in single.data_vars:
        assert (shared[name].dims, shared[name].attrs) == (single[name].dims, single[name].attrs)


@NEEDS_JIT
def test_optically_equal_points_keep_their_attributes():
    """An impurity of which there is none has no effect."""
    equal = {"a": {}, "b": {"impurities_ng_g": {"black_carbon": 0}}}
    snow = {"kind": "natural_snow", "specific_surface_area_m2_kg": 20}
    dataset = run(make_config(medium=snow, grid={"medium": equal}), ACCURACY, seed=5, threads=2)
    assert dataset.attrs["snow_specific_surface_area_m2_kg"] == pytest.approx(20.0)
    np.testing.assert_array_equal(dataset.reflectance[0], dataset.reflectance[1])


@NEEDS_JIT
def test_polarization_is_traced_along_shared_paths():
    """It changes the path of light, and the incident light of each point has a Stokes vector."""
    snow = {"kind": "natural_snow", "density_kg_m3": 300}
    spectra = []
    for stokes in (False, True):
        instrument = {"wavelength_nm": [1310], "solver": "monte_carlo", "stokes": stokes}
        grid = {"specific_surface_area_m2_kg": [10, 20]}
        config = make_config(medium=snow, grid=grid, instrument=instrument)
        points, rays = simulate_points(config, ACCURACY, 5, 2, lambda line: None)
        assert rays == points[0].attrs["rays"] == points[1].attrs["rays"]
        assert all(("incident_stokes" in point.attrs) == stokes for point in points)
        spectra.append([float(point.reflectance[0]) for point in points])
    assert (np.diff(spectra, axis=0) != 0.0).all()


@NEEDS_JIT
def test_particle_layers_over_several_grounds_share_paths():
    soil = splits.ParticleLayer(optical_thickness=2.0, ground="quartzipsamment")
    wavelengths = [500.0, 900.0]
    albedos = soil.ground.albedo(np.array(wavelengths)).tolist()
    media = {
        albedo: splits.ParticleLayer(optical_thickness=2.0, ground=albedo) for albedo in albedos
    }
    over_soil = splits.spectrophotometer(soil, wavelengths, 30.0, max_stderr=0.002)
    constant = splits.spectrophotometer(media, wavelengths, 30.0, max_stderr=0.002, seed=1)
    for quantity in ("reflectance", "transmittance"):
        # The albedos of the layers are those of the soil at the wavelengths.
        one, other = over_soil[quantity].values, np.diagonal(constant[quantity].values)
        stderr = np.hypot(
            over_soil[f"{quantity}_stderr"].values,
            np.diagonal(constant[f"{quantity}_stderr"].values),
        )
        assert (np.abs(one - other) < 4.0 * stderr).all()


@NEEDS_JIT
@pytest.mark.parametrize("estimator", ["expansion", "bins"])
def test_directions_over_a_spectral_ground(estimator):
    table = {"wavelength_nm": [400, 500, 900, 1000], "albedo": [0.1, 0.1, 0.6, 0.6]}
    layer = splits.ParticleLayer(optical_thickness=1.0, ground=table)
    settings = {"estimator": estimator, "relative_stderr": 0.1}
    if estimator == "bins":
        settings |= {"n_bins": (4, 8), "rays": 20_000}
    directions = splits.goniophotometer(layer, [500.0, 900.0], 0.0, **settings)
    assert "btdf" not in directions
    fluxes = splits.spectrophotometer(layer, [500.0, 900.0], 0.0, max_stderr=0.002, seed=1)
    assert (np.abs(compare_results(directions, fluxes, "reflectance")) < 4.0).all()
    with pytest.raises(InvalidValue, match="a ground that depends on wavelength"):
        splits.goniophotometer(layer, [500.0], 0.0, estimator="next_event")
