"""Truncated deep media: agreement with complete media, and limits of the diffusion substrate."""

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results, judge_z

import splits
from splits.core.validation import InvalidValue
from splits.simulation import deep_medium
from splits.simulation.deep_medium import (
    THEORY_UNCERTAINTY,
    DiffusiveSubstrate,
    diffuse_reflectance,
    truncate_deep_medium,
)
from splits.simulation.grain_optics import (
    GRAIN_RAYS_PER_CHUNK,
    WEIGHTED_MEANS,
    GrainOpticsRequest,
    pool_optics_by_type,
)
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import compute_material_constants
from splits.simulation.shared_paths import PathSharingMedia

CLEAR = {"ice": 1.31, "water": 1.33}
RUN = RunOptions.start(1, 2)
WAVELENGTHS = np.array([450.0, 700.0, 850.0, 1000.0])
FINE = {"grain_size_um": (50.0, 100.0), "density_kg_m3": 300.0}
MEDIA = {
    "dry": splits.Snow(**FINE, saturation=0.0, depth_m=0.03),
    "wet": splits.Snow(**FINE, saturation=0.3, depth_m=0.03),
    "soaked": splits.Snow(**FINE, saturation=1.0, depth_m=0.12),
    "on soil": splits.Snow(**FINE, saturation=0.0, depth_m=0.02, ground=0.6),
    "layered": splits.Stack(
        [splits.Snow(depth_m=0.003), splits.Snow(**FINE, saturation=0.0, depth_m=0.02)]
    ),
}


@pytest.fixture
def truncate_always(monkeypatch):
    """Truncate media of any depth."""
    monkeypatch.setattr(deep_medium, "MIN_DEPTH_MFP", 0.0)


@NEEDS_JIT
@pytest.mark.long
@pytest.mark.parametrize("name", MEDIA)
def test_truncated_medium_agrees_with_complete_medium(truncate_always, monkeypatch, name):
    """Truncated for 2 % but traced to a smaller error: the difference is that of theory."""
    medium = MEDIA[name]
    truncated = truncate_deep_medium(PathSharingMedia.from_media([medium]), WAVELENGTHS, 0.02, RUN)
    assert truncated is not None
    assert truncated.depth_m < 0.7 * medium.depth_m
    monkeypatch.setattr(deep_medium, "MIN_DEPTH_MFP", math.inf)
    for seed, incidence in ((2, 0.0), (3, "diffuse")):
        run, reference = (
            splits.spectrophotometer(traced, WAVELENGTHS, incidence, max_stderr=0.0015, seed=seed)
            for traced in (truncated.path_sharing.media[0], medium)
        )
        transmittance = run.transmittance.values
        theory_errors = {
            "reflectance": THEORY_UNCERTAINTY * transmittance * truncated.escape_probability[0],
            "transmittance": THEORY_UNCERTAINTY * transmittance,
        }
        estimates = {
            "reflectance": run.reflectance.values,
            "transmittance": transmittance * truncated.transmitted_fraction[0],
        }
        for quantity, theory_error in theory_errors.items():
            noise = np.hypot(run[f"{quantity}_stderr"], reference[f"{quantity}_stderr"]).values
            difference = np.abs(estimates[quantity] - reference[quantity].values)
            print(
                name,
                incidence,
                quantity,
                np.round(difference / np.maximum(theory_error / THEORY_UNCERTAINTY, 1e-9), 2),
            )
            assert (difference <= theory_error + 3.0 * noise).all(), (
                name,
                incidence,
                quantity,
                difference,
                theory_error,
            )


@NEEDS_JIT
@pytest.mark.parametrize("max_stderr", [0.02, 0.002])
def test_pilot_run_does_not_change_the_decision(monkeypatch, max_stderr):
    """Media that the pilot run rejects for truncation are also rejected by a larger run."""
    media = [
        splits.Sand(),
        splits.Sand(saturation=0.5, depth_m=0.1),
        splits.Sand(iron_oxide=0.0),
        splits.Snow(depth_m=1.0),
        splits.Snow(**FINE, depth_m=0.3),
        splits.Snow(**FINE, saturation=0.0, depth_m=2.0),
    ]
    with_pilot = [
        truncate_deep_medium(PathSharingMedia.from_media([medium]), WAVELENGTHS, max_stderr, RUN)
        for medium in media
    ]
    monkeypatch.setattr(deep_medium, "PILOT_MARGIN", math.inf)
    without_pilot = [
        truncate_deep_medium(PathSharingMedia.from_media([medium]), WAVELENGTHS, max_stderr, RUN)
        for medium in media
    ]
    assert [truncated and truncated.depth_m for truncated in with_pilot] == [
        truncated and truncated.depth_m for truncated in without_pilot
    ]
    assert 0 < without_pilot.count(None) < len(media)
    calls = []
    monkeypatch.undo()
    monkeypatch.setattr(deep_medium, "pool_optics_by_type", lambda *_: calls.append(1))
    assert (
        truncate_deep_medium(
            PathSharingMedia.from_media([splits.Sand()]), WAVELENGTHS, max_stderr, RUN
        )
        is None
    )
    assert not calls


@NEEDS_JIT
@pytest.mark.parametrize("ground", [None, 0.5])
def test_absorption_above_a_transparent_layer_is_kept(ground):
    """Transparent quartz lies below snow that absorbs almost all light at 1500 nm."""
    transparent = {"iron_oxide": 0.0, "partition": (1, 0, 0), "saturation": 0.0}
    runs = [
        splits.spectrophotometer(
            splits.Stack(
                [splits.Snow(), splits.Sand(**transparent, depth_m=depth)],
                ground=ground,
                interpretation="splits_2007",
            ),
            [500.0, 1500.0],
            max_stderr=0.02,
            seed=seed,
        )
        for seed, depth in enumerate((1.0, 0.007), start=1)
    ]
    assert "truncation_depth_m" in runs[0].attrs
    assert "truncation_depth_m" not in runs[1].attrs
    for run in runs:
        assert run.absorptance[1] > 0.9
    assert abs(compare_results(*runs, "absorptance")[1]) < 4.0


@NEEDS_JIT
def test_stated_errors_of_truncated_media(truncate_always, monkeypatch):
    light = {"wavelength_nm": WAVELENGTHS, "incidence_deg": 60.0}
    truncated = splits.spectrophotometer(MEDIA["dry"], seed=4, max_stderr=0.01, **light)
    assert truncated.attrs["truncation_depth_m"] < MEDIA["dry"].depth_m
    monkeypatch.setattr(deep_medium, "MIN_DEPTH_MFP", math.inf)
    reference = splits.spectrophotometer(MEDIA["dry"], seed=5, max_stderr=0.002, **light)
    z = compare_results(truncated, reference, "reflectance", "transmittance")
    judge_z(z, independent=1, bound_added=True)
    total = truncated.reflectance + truncated.transmittance + truncated.absorptance
    assert total.values == pytest.approx(1.0, abs=1e-12)


@NEEDS_JIT
def test_rare_absorbing_grains_are_included():
    """One grain in 20 000 absorbs, and dominates absorption; a small sample contains none."""
    sand = splits.Sand(iron_oxide=0.0, magnetite=1e-4, partition=(1.0, 0.0, 0.0))
    truncated = truncate_deep_medium(
        PathSharingMedia.from_media([sand]), np.array([600.0]), 0.005, RUN
    )
    assert truncated is not None
    assert truncated.transmitted_fraction[0, 0] < 0.5


@NEEDS_JIT
@pytest.mark.parametrize("depth_m", [0.5, math.inf])
def test_transparent_sand_of_several_types_absorbs_nothing(depth_m):
    """Holds although fractions of types do not add up to 1 exactly in floating point."""
    transparent = splits.Sand(
        iron_oxide=0.0, hematite_ratio=0.5, partition=(0.3, 0.7, 0.0), saturation=0.0,
        depth_m=depth_m,
    )  # fmt: skip
    ds = splits.spectrophotometer(transparent, [600.0], max_stderr=0.01)
    assert "truncation_depth_m" in ds.attrs
    np.testing.assert_allclose(ds.reflectance + ds.transmittance, 1.0, rtol=0.0, atol=1e-12)
    assert float(ds.absorptance[0]) == pytest.approx(0.0, abs=1e-12)
    if depth_m < math.inf:
        assert float(ds.transmittance_stderr[0]) >= float(ds.reflectance_stderr[0])


@NEEDS_JIT
def test_pooled_optics_of_types_equal_the_mixture():
    sand = splits.Sand(hematite_ratio=0.5, magnetite=0.05, saturation=0.3, texture=(0.0, 0.1, 0.9))
    light = np.array([500.0, 800.0])
    pooled = pool_optics_by_type(
        sand,
        compute_material_constants(sand, light),
        GrainOpticsRequest(1, 50 * GRAIN_RAYS_PER_CHUNK, "equilibrium", RUN),
    )
    mixed = splits.single_scattering(
        sand, light, moments=1, rays=50 * GRAIN_RAYS_PER_CHUNK, seed=2, wet_pores="equilibrium"
    )
    z = []
    for name in ("single_scattering_albedo", "asymmetry_parameter", *WEIGHTED_MEANS):
        # Means of single types have standard errors no larger than those of the mixture.
        error = np.sqrt(2.0) * mixed[f"{name}_stderr"]
        z.append(((pooled[name].values - mixed[name]) / error).values)
    judge_z(np.array(z), independent=2, bound_added=True)


@NEEDS_JIT
def test_semi_infinite_conservative_medium_reflects_all_light():
    snow = splits.Snow(**FINE, saturation=0.2, refractive_index=CLEAR, depth_m=math.inf)
    ds = splits.spectrophotometer(snow, [500.0], 30.0, max_stderr=0.01)
    assert ds.reflectance.item() == pytest.approx(1.0, abs=1e-5)
    assert ds.attrs["stop_reason"] == "converged"


@NEEDS_JIT
def test_semi_infinite_medium_agrees_with_a_deep_one():
    light = {"wavelength_nm": [800.0, 1000.0, 1300.0], "incidence_deg": 50.0, "max_stderr": 0.004}
    semi_infinite = splits.spectrophotometer(splits.Snow(depth_m=math.inf), seed=6, **light)
    depth_m = semi_infinite.attrs["semi_infinite_depth_m"]
    finite = splits.spectrophotometer(splits.Snow(depth_m=depth_m), seed=7, **light)
    error = np.hypot(semi_infinite.reflectance_stderr, finite.reflectance_stderr)
    difference = np.abs(semi_infinite.reflectance - finite.reflectance)
    assert (difference <= 0.004 + 3.0 * error).all()
    assert (semi_infinite.transmittance == 0.0).all()


def test_diffuse_reflectance_follows_the_closed_form():
    """Walsh's closed form of the Fresnel integral for n > 1; reciprocity for n < 1."""
    n = np.array([1.1, 1.33, 1.5, 2.0])
    square = n**2
    closed = (
        0.5
        + (n - 1.0) * (3.0 * n + 1.0) / (6.0 * (n + 1.0) ** 2)
        + square * (square - 1.0) ** 2 / (square + 1.0) ** 3 * np.log((n - 1.0) / (n + 1.0))
        - 2.0 * n**3 * (square + 2.0 * n - 1.0) / ((square + 1.0) * (n**4 - 1.0))
        + 8.0 * n**4 * (n**4 + 1.0) / ((square + 1.0) * (n**4 - 1.0) ** 2) * np.log(n)
    )
    assert diffuse_reflectance(n) == pytest.approx(closed, abs=1e-6)
    assert diffuse_reflectance(1.0 / n) == pytest.approx(1.0 - (1.0 - closed) / square, abs=1e-3)
    assert diffuse_reflectance(np.array(1.0)) == pytest.approx(0.0, abs=1e-12)


def test_diffusive_substrate_has_the_known_limits():
    """Without absorption: 1/(2 + h/D) reaches a black bottom; a white one reflects all light."""
    one = np.ones(1)
    diffusion, height = 1e-4, 0.5
    rate = 1e-8
    black = DiffusiveSubstrate(rate * diffusion * one, rate * height * one, 0.5 * one)
    expected = 1.0 / (2.0 + height / diffusion)
    assert black.compute_flux_ratio() == pytest.approx(expected, rel=1e-9)
    assert black.compute_transmitted_fraction() == pytest.approx(1.0, rel=1e-9)
    white = DiffusiveSubstrate(rate * diffusion * one, rate * height * one, 0.0 * one)
    assert white.compute_reflected_fraction() == pytest.approx(1.0, abs=1e-9)
    semi_infinite = DiffusiveSubstrate(0.3 * one, math.inf * one, 0.5 * one)
    assert semi_infinite.compute_flux_ratio() == pytest.approx(0.3)
    assert semi_infinite.compute_transmitted_fraction() == 0.0
    thick, thin = (DiffusiveSubstrate(0.3 * one, h * one, 0.5 * one) for h in (30.0, 1e-12))
    assert thick.compute_reflected_fraction() == pytest.approx(
        semi_infinite.compute_reflected_fraction()
    )
    assert thin.compute_reflected_fraction() == pytest.approx(0.0, abs=1e-9)
    assert thin.compute_transmitted_fraction() == pytest.approx(1.0)


@pytest.mark.parametrize(
    "instrument",
    [
        lambda snow: splits.goniophotometer(snow, [500.0]),
        lambda snow: splits.beam_spread(snow, [500.0]),
        lambda snow: splits.spectrophotometer(snow, [500.0], estimator="analog"),
    ],
)
def test_other_instruments_reject_semi_infinite_media(instrument):
    with pytest.raises(InvalidValue, match="depth_m = inf: must be finite"):
        instrument(splits.Snow(depth_m=math.inf))


def test_only_the_lowest_layer_may_be_semi_infinite():
    semi_infinite = splits.Snow(depth_m=math.inf)
    assert splits.Stack([splits.Snow(), semi_infinite]).depth_m == math.inf
    with pytest.raises(InvalidValue, match=r"layers\[0\].depth_m = inf: must be finite"):
        splits.Stack([semi_infinite, splits.Snow()])
