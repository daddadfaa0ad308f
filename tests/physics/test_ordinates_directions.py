"""BRDFs and reflectance factors of natural snow by discrete ordinates against paths."""

import os

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results, judge_z

import splits
from splits.discrete_ordinates.granular_stack import WET_ERROR
from splits.instruments.goniophotometer import BEAM_TOTALS

WAVELENGTHS = [600.0, 1030.0, 1500.0]
DIRECTIONS = {"polar_deg": [0.0, 25.0, 50.0, 75.0], "azimuth_deg": [0.0, 60.0, 120.0, 180.0, 300.0]}
FEW = {"polar_deg": [0.0, 53.0], "azimuth_deg": [0.0, 90.0]}
TRACED, SOLVED = {"solver": "monte_carlo"}, {"solver": "discrete_ordinates"}


def make_snow(**settings):
    keywords = {"specific_surface_area_m2_kg": 20.0, "depth_m": 0.05, "ground": 0.3} | settings
    return splits.Snow.natural(**keywords)


def make_thin(**settings):
    """Return snow that transmits a part of the light at all wavelengths."""
    return make_snow(**{"depth_m": 0.002, "ground": None} | settings)


def make_stack(water=0.0):
    fresh = splits.Snow.natural(specific_surface_area_m2_kg=60.0, density_kg_m3=100, depth_m=0.001)
    old = {"specific_surface_area_m2_kg": 8.0, "depth_m": 0.002}
    return splits.Stack([fresh, splits.Snow.natural(**old, liquid_water_content=water)])


MEDIA = {
    "ground": make_snow(),
    "thin": make_thin(),
    "stack": make_stack(),
    "wet": make_thin(liquid_water_content=0.1),
    "wet over ground": make_snow(liquid_water_content=0.05),
    "wet below dry": make_stack(0.05),
}
CASES = [
    *(("ground", incidence, 0.015) for incidence in (0.0, 53.0, 70.0)),
    ("thin", 70.0, 0.02),
    ("wet", 53.0, 0.02),
    ("wet below dry", "diffuse", 0.02),
]
"""Medium, incidence, and error of the paths."""
MORE_CASES = [
    ("ground", "diffuse", 0.015),
    *(("thin", incidence, 0.02) for incidence in (0.0, "diffuse")),
    *(("wet", incidence, 0.02) for incidence in (0.0, 70.0, "diffuse")),
    ("wet below dry", 53.0, 0.02),
    ("stack", 53.0, 0.015),
    ("wet over ground", 0.0, 0.02),
]
CASES += MORE_CASES if "SNOWPACKS" in os.environ else []
NAMES = ("reflectance", "transmittance", "brdf", "btdf", "transmittance_factor")


def compare(instrument, medium, *arguments, names=NAMES, rays=None, **settings):
    """Return differences from paths over their errors, of distributions and of their integrals."""
    paths, solved = (
        instrument(medium, *arguments, seed=3, **DIRECTIONS, **settings, **solver)
        for solver in ({"rays": rays, **TRACED} if rays else TRACED, SOLVED)
    )
    names = ["reflectance_factor", *names] if "brdf" not in solved else names
    return [compare_results(solved, paths, name) for name in names if name in solved]


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(("name", "incidence", "error"), CASES)
def test_directions_agree_with_paths(name, incidence, error):
    z = compare(splits.goniophotometer, MEDIA[name], WAVELENGTHS, incidence, relative_stderr=error)
    label = f"{name} {incidence}"
    judge_z(np.concatenate(z), label, independent=len(WAVELENGTHS), bound_added=True)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("name", ["thin", "wet"])
def test_directions_agree_with_bins(name):
    """Bins have no error of polynomials, also in the forward peak of wet pores."""
    bins = {"estimator": "bins", "n_bins": (30, 72)}
    paths = splits.goniophotometer(MEDIA[name], [600.0], 53.0, rays=2_000_000, seed=3, **bins)
    paths = paths.sortby("polar_deg")
    directions = {"polar_deg": paths.polar_deg.values, "azimuth_deg": paths.azimuth_deg.values}
    solved = splits.goniophotometer(MEDIA[name], [600.0], 53.0, **directions, **SOLVED)
    judge_z(compare_results(solved, paths, "brdf", "btdf"), name, bound_added=True)


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_light_without_scattering_agrees_with_paths():
    """A number of rays leaves no light to rarely sampled strata."""
    z = compare(
        splits.goniophotometer, MEDIA["wet"], WAVELENGTHS, 53.0, rays=2_000_000,
        names=("specular_reflectance", "direct_transmittance"),
    )  # fmt: skip
    judge_z(np.concatenate(z), independent=len(WAVELENGTHS))


@NEEDS_JIT
@pytest.mark.slow
@pytest.mark.long
def test_mixed_sky_agrees_with_paths():
    sky = splits.sky("midlatitude_winter")
    z = compare(splits.hdrf, make_snow(), sky, WAVELENGTHS, relative_stderr=0.04)
    judge_z(np.concatenate(z), independent=len(WAVELENGTHS), bound_added=True)


@pytest.mark.parametrize("name", ["ground", "stack", "wet below dry"])
def test_brdf_is_reciprocal(name):
    angles = [0.0, 30.0, 53.0, 75.0]
    brdf = np.stack([
        splits.goniophotometer(
            MEDIA[name], WAVELENGTHS, angle, polar_deg=angles, azimuth_deg=[0.0, 70.0, 180.0],
            relative_stderr=0.5, **SOLVED,
        ).brdf.values
        for angle in angles
    ])  # fmt: skip
    np.testing.assert_allclose(brdf, np.swapaxes(brdf, 0, 2), rtol=1e-8)


@pytest.mark.parametrize(("depth_m", "water"), [(0.002, 0.0), (np.inf, 0.0), (0.002, 0.1)])
def test_distributions_integrate_to_totals_of_spectrophotometer(depth_m, water):
    x, w = np.polynomial.legendre.leggauss(32)
    cosines, weights = 0.5 * (x + 1.0)[::-1], 0.5 * w[::-1]
    polar = np.degrees(np.arccos(cosines))
    snow = make_snow(depth_m=depth_m, ground=None, liquid_water_content=water)
    arguments = (snow, WAVELENGTHS, 53.0)
    solved = splits.goniophotometer(
        *arguments, polar_deg=polar, azimuth_deg=np.arange(0.0, 360.0, 5.0), relative_stderr=0.01,
        **SOLVED,
    )  # fmt: skip
    reflected, transmitted = (
        2.0 * np.pi * solved[name].mean("azimuth_deg").values @ (weights * cosines)
        for name in ("brdf", "btdf")
    )
    spectrum = splits.spectrophotometer(*arguments, max_stderr=1e-4, **SOLVED)
    # Distributions of wet snow assume the equilibrium with air in all layers.
    error = WET_ERROR if water else 0.0
    for scattered, total, direct in (
        (reflected, solved.reflectance, solved.specular_reflectance),
        (transmitted, solved.transmittance, solved.direct_transmittance),
    ):
        np.testing.assert_allclose(scattered + direct, total, rtol=3e-3, atol=error)
    for name in ("reflectance", "transmittance"):
        np.testing.assert_allclose(solved[name], spectrum[name], atol=1e-4)
    # π times the BRDF over the reflectance, so that its mean is the share of scattered light.
    share = 1.0 - (solved.specular_reflectance / solved.reflectance).values
    anisotropy = 2.0 * solved.anisotropy_factor.mean("azimuth_deg").values @ (weights * cosines)
    assert (np.abs(anisotropy - share) <= 3e-3 + 1.1 * error / solved.reflectance).all()


def test_factors_under_diffuse_light_are_totals_of_a_beam():
    """The beam of the transmittance factor enters from below."""
    stack = MEDIA["wet below dry"]
    solved = splits.goniophotometer(stack, WAVELENGTHS, "diffuse", **FEW, **SOLVED)
    inverted = splits.Stack(stack.layers[::-1])
    for name, medium in (("reflectance", stack), ("transmittance", inverted)):
        beam = splits.spectrophotometer(medium, WAVELENGTHS, 53.0, **SOLVED)
        factor = solved[f"{name}_factor"].sel(polar_deg=53.0)
        np.testing.assert_allclose(factor, beam[name].values[:, None] * np.ones(2), atol=1e-3)


@pytest.mark.parametrize("incidence", [30.0, "diffuse"])
def test_target_limits_the_error_of_its_side(incidence):
    settings = {"relative_stderr": 0.01, **FEW, **SOLVED}
    for name, target in (("reflectance", "brdf"), ("transmittance", "btdf")):
        name = f"{name}_factor" if incidence == "diffuse" else target
        solved = splits.goniophotometer(
            MEDIA["thin"], [600.0], incidence, target=target, **settings
        )
        error = float((solved[f"{name}_stderr"] / solved[name]).max())
        assert error == pytest.approx(solved.attrs["relative_stderr_reached"], rel=1e-9)
        assert error < 0.01 and solved.attrs["stop_reason"] == "converged"


def test_dataset_has_the_form_of_simulations(tmp_path):
    solved = splits.goniophotometer(make_snow(ground=None), WAVELENGTHS, 30.0, **FEW, **SOLVED)
    assert solved.attrs["solver"] == "discrete_ordinates" and solved.attrs["rays"] == 0
    assert solved.brdf.dims == ("wavelength", "polar_deg", "azimuth_deg")
    paths = {"brdf", "btdf", "reflectance_factor", "anisotropy_factor", *BEAM_TOTALS}
    assert set(solved) == paths | {f"{name}_stderr" for name in paths}
    splits.save(solved, tmp_path / "brdf.nc")
    loaded = splits.load(tmp_path / "brdf.nc")
    np.testing.assert_array_equal(loaded.brdf, solved.brdf)
    assert not {"btdf", "transmittance", "direct_transmittance"} & set(
        splits.goniophotometer(make_snow(), WAVELENGTHS, 30.0, **FEW, **SOLVED)
    )


def test_figures_accept_the_dataset():
    plotting = pytest.importorskip("splits.plotting.principal_plane", exc_type=ImportError)
    solved = splits.goniophotometer(make_snow(), WAVELENGTHS, 53.0, **SOLVED)
    figure = plotting.draw_principal_planes(solved, ["brdf"])
    assert figure.axes
    figure.clear()


@pytest.mark.parametrize(
    ("medium", "settings", "reason"),
    [
        (make_snow(saturation=0.6), {}, "a saturation of 0.6"),
        (
            make_snow(),
            {"estimator": "bins", "polar_deg": None, "azimuth_deg": None},
            "the estimator bins needs paths",
        ),
        (make_snow(), {"rays": 1000}, "a number of rays"),
        (splits.Snow(depth_m=0.1, saturation=0.0), {}, "overlap_with_boundary"),
    ],
)
def test_refusals_state_the_reason(medium, settings, reason):
    with pytest.raises(ValueError, match=rf"(?s)solver.*{reason}"):
        splits.goniophotometer(medium, WAVELENGTHS, 30.0, **{**FEW, **SOLVED, **settings})


def test_semi_infinite_snow_needs_discrete_ordinates():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20.0)
    assert splits.goniophotometer(snow, [900.0], **FEW).attrs["rays"] == 0
    with pytest.raises(ValueError, match="depth_m"):
        splits.goniophotometer(snow, [900.0], **FEW, **TRACED)
    wet = splits.Snow.natural(specific_surface_area_m2_kg=20.0, saturation=0.6)
    with pytest.raises(ValueError, match="depth_m"):
        splits.goniophotometer(wet, [900.0], **FEW, solver="auto")
    with pytest.raises(ValueError, match=r"(?s)solver.*saturation"):
        splits.hdrf(wet, "midlatitude_winter", [900.0], **FEW, **SOLVED)


def test_auto_solves_wet_snow():
    wet = make_snow(liquid_water_content=0.02)
    solved = splits.goniophotometer(wet, [900.0], 30.0, **FEW, solver="auto")
    assert solved.attrs["solver"] == "discrete_ordinates"


@pytest.mark.parametrize("water", [0.0, 0.05])
def test_small_transmittances_have_relative_errors(water):
    snow = make_snow(depth_m=0.1, ground=None, liquid_water_content=water)
    arguments = (snow, [1030.0], 30.0)
    solved = splits.goniophotometer(*arguments, **FEW, **SOLVED)
    spectrum = splits.spectrophotometer(*arguments, **SOLVED)
    assert solved.transmittance.item() < 1e-4
    for dataset in (solved, spectrum):
        assert (dataset.transmittance_stderr < 0.03 * dataset.transmittance).all()
    assert (solved.btdf_stderr < 0.1 * solved.btdf).all()
