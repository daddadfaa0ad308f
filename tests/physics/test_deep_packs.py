"""Packs that are cut: against the same packs traced to their end, and limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits
from splits.core.validation import InvalidValue
from splits.simulation import deep_medium
from splits.simulation.deep_medium import truncate_deep_medium
from splits.simulation.diffusion import DiffusiveSubstrate, diffuse_reflectance
from splits.simulation.grain_optics import (
    GRAIN_RAYS_PER_CHUNK,
    GrainOpticsRequest,
    compute_material_constants,
    pool_optics_by_type,
)
from splits.simulation.grain_optics_means import WEIGHTED_MEANS
from splits.simulation.path_tally import PathSharingMedia
from splits.simulation.truncated_medium import THEORY_UNCERTAINTY

CLEAR = {"ice": 1.31, "water": 1.33}
WAVELENGTHS = np.array([450.0, 700.0, 850.0, 1000.0])
FINE = {"grain_size_um": (50.0, 100.0), "density_kg_m3": 300.0}
PACKS = {
    "dry": splits.Snow(**FINE, saturation=0.0, depth_m=0.03),
    "wet": splits.Snow(**FINE, saturation=0.3, depth_m=0.03),
    "soaked": splits.Snow(**FINE, saturation=1.0, depth_m=0.12),
    "on soil": splits.Snow(**FINE, saturation=0.0, depth_m=0.02, ground=0.6),
    "layered": splits.Stack(
        [splits.Snow(depth_m=0.003), splits.Snow(**FINE, saturation=0.0, depth_m=0.02)]
    ),
}


@pytest.fixture
def always(monkeypatch):
    """Cut however thin a pack is."""
    monkeypatch.setattr(deep_medium, "MIN_DEPTH_MFP", 0.0)


@NEEDS_JIT
@pytest.mark.long
@pytest.mark.parametrize("name", PACKS)
def test_a_cut_pack_answers_as_the_whole(always, monkeypatch, name):
    """Cut where 2 % would be asked for, and traced far better: what is left is theory's."""
    pack = PACKS[name]
    cut = truncate_deep_medium(PathSharingMedia.from_media([pack]), WAVELENGTHS, 0.02, 1, 2)
    assert cut is not None
    assert cut.depth_m < 0.7 * pack.depth_m
    monkeypatch.setattr(deep_medium, "MIN_DEPTH_MFP", math.inf)
    for seed, incidence in ((2, 0.0), (3, "diffuse")):
        part, whole = (
            splits.spectrophotometer(one, WAVELENGTHS, incidence, 0.0015, seed)
            for one in (cut.media[0], pack)
        )
        kept = part.transmittance.values
        doubts = {
            "reflectance": THEORY_UNCERTAINTY * kept * cut.escape_probability[0],
            "transmittance": THEORY_UNCERTAINTY * kept,
        }
        guessed = {
            "reflectance": part.reflectance.values,
            "transmittance": kept * cut.transmitted_fraction[0],
        }
        for quantity, doubt in doubts.items():
            noise = np.hypot(part[f"{quantity}_stderr"], whole[f"{quantity}_stderr"]).values
            off = np.abs(guessed[quantity] - whole[quantity].values)
            print(
                name,
                incidence,
                quantity,
                np.round(off / np.maximum(doubt / THEORY_UNCERTAINTY, 1e-9), 2),
            )
            assert (off <= doubt + 3.0 * noise).all(), (name, incidence, quantity, off, doubt)


@NEEDS_JIT
@pytest.mark.parametrize("max_stderr", [0.02, 0.002])
def test_a_rough_look_spares_time_and_changes_nothing(monkeypatch, max_stderr):
    """What it does not look into any further, a better look would not cut either."""
    packs = [
        splits.Sand(),
        splits.Sand(saturation=0.5, depth_m=0.1),
        splits.Sand(iron_oxide=0.0),
        splits.Snow(depth_m=1.0),
        splits.Snow(**FINE, depth_m=0.3),
        splits.Snow(**FINE, saturation=0.0, depth_m=2.0),
    ]
    decided = [
        truncate_deep_medium(PathSharingMedia.from_media([pack]), WAVELENGTHS, max_stderr, 1, 2)
        for pack in packs
    ]
    monkeypatch.setattr(deep_medium, "PILOT_MARGIN", math.inf)
    better = [
        truncate_deep_medium(PathSharingMedia.from_media([pack]), WAVELENGTHS, max_stderr, 1, 2)
        for pack in packs
    ]
    assert [cut and cut.depth_m for cut in decided] == [cut and cut.depth_m for cut in better]
    assert 0 < better.count(None) < len(packs)
    looked = []
    monkeypatch.undo()
    monkeypatch.setattr(deep_medium, "pool_optics_by_type", lambda *_: looked.append(1))
    assert (
        truncate_deep_medium(
            PathSharingMedia.from_media([splits.Sand()]), WAVELENGTHS, max_stderr, 1, 2
        )
        is None
    )
    assert not looked


@NEEDS_JIT
@pytest.mark.parametrize("ground", [None, 0.5])
def test_what_layers_above_a_clear_one_absorb_stays_absorbed(ground):
    """Clear quartz below, and snow above that is black at 1500 nm."""
    clear = {"iron_oxide": 0.0, "partition": (1, 0, 0), "saturation": 0.0}
    found = [
        splits.spectrophotometer(
            splits.Stack(
                [splits.Snow(), splits.Sand(**clear, depth_m=depth)],
                ground=ground,
                interpretation="splits_2007",
            ),
            [500.0, 1500.0],
            max_stderr=0.02,
            seed=seed,
        )
        for seed, depth in enumerate((1.0, 0.007), start=1)
    ]
    assert "truncation_depth_m" in found[0].attrs
    assert "truncation_depth_m" not in found[1].attrs
    for one in found:
        assert one.absorptance[1] > 0.9
    spread = np.hypot(found[0].absorptance_stderr[1], found[1].absorptance_stderr[1])
    assert abs(found[0].absorptance[1] - found[1].absorptance[1]) < 4.0 * spread


@NEEDS_JIT
def test_errors_of_cut_packs_hold(always, monkeypatch):
    light = {"wavelength_nm": WAVELENGTHS, "incidence_deg": 60.0}
    cut = splits.spectrophotometer(PACKS["dry"], seed=4, max_stderr=0.01, **light)
    assert cut.attrs["truncation_depth_m"] < PACKS["dry"].depth_m
    monkeypatch.setattr(deep_medium, "MIN_DEPTH_MFP", math.inf)
    whole = splits.spectrophotometer(PACKS["dry"], seed=5, max_stderr=0.002, **light)
    z = [
        (cut[n] - whole[n]) / np.hypot(cut[f"{n}_stderr"], whole[f"{n}_stderr"])
        for n in ("reflectance", "transmittance")
    ]
    judge_z(np.array(z), independent=1, bound_added=True)
    total = cut.reflectance + cut.transmittance + cut.absorptance
    assert total.values == pytest.approx(1.0, abs=1e-12)


@NEEDS_JIT
def test_rare_dark_grains_are_not_overlooked():
    """One grain in 20 000 absorbs, and all light in the end: a small sample meets none."""
    sand = splits.Sand(iron_oxide=0.0, magnetite=1e-4, partition=(1.0, 0.0, 0.0))
    cut = truncate_deep_medium(PathSharingMedia.from_media([sand]), np.array([600.0]), 0.005, 1, 2)
    assert cut is not None
    assert cut.transmitted_fraction[0, 0] < 0.5


@NEEDS_JIT
@pytest.mark.parametrize("depth_m", [0.5, math.inf])
def test_clear_sand_of_several_types_absorbs_nothing(depth_m):
    """Whatever the shares of types add up to, in floating point."""
    clear = splits.Sand(
        iron_oxide=0.0, hematite_ratio=0.5, partition=(0.3, 0.7, 0.0), saturation=0.0,
        depth_m=depth_m,
    )  # fmt: skip
    ds = splits.spectrophotometer(clear, [600.0], max_stderr=0.01)
    assert "truncation_depth_m" in ds.attrs
    np.testing.assert_allclose(ds.reflectance + ds.transmittance, 1.0, rtol=0.0, atol=1e-12)
    assert float(ds.absorptance[0]) == pytest.approx(0.0, abs=1e-12)
    if depth_m < math.inf:
        assert float(ds.transmittance_stderr[0]) >= float(ds.reflectance_stderr[0])


@NEEDS_JIT
def test_types_measured_one_by_one_are_the_mixture():
    sand = splits.Sand(hematite_ratio=0.5, magnetite=0.05, saturation=0.3, texture=(0.0, 0.1, 0.9))
    light = np.array([500.0, 800.0])
    each = pool_optics_by_type(
        sand,
        compute_material_constants(sand, light),
        GrainOpticsRequest(1, 50 * GRAIN_RAYS_PER_CHUNK, 1, 2, "equilibrium"),
    )
    mixed = splits.single_scattering(
        sand, light, 1, 50 * GRAIN_RAYS_PER_CHUNK, 2, wet_pores="equilibrium"
    )
    z = []
    for name in ("single_scattering_albedo", "asymmetry_parameter", *WEIGHTED_MEANS):
        # Types by themselves know a mean at least as well as a mixture.
        error = np.sqrt(2.0) * mixed[f"{name}_stderr"]
        z.append(((each[name].values - mixed[name]) / error).values)
    judge_z(np.array(z), independent=2, bound_added=True)


@NEEDS_JIT
def test_a_pack_without_end_that_absorbs_nothing_sends_all_light_back():
    snow = splits.Snow(**FINE, saturation=0.2, refractive_index=CLEAR, depth_m=math.inf)
    ds = splits.spectrophotometer(snow, [500.0], 30.0, 0.01)
    assert ds.reflectance.item() == pytest.approx(1.0, abs=1e-5)
    assert ds.attrs["stop_reason"] == "converged"


@NEEDS_JIT
def test_a_pack_without_end_is_one_that_is_deep_enough():
    light = {"wavelength_nm": [800.0, 1000.0, 1300.0], "incidence_deg": 50.0, "max_stderr": 0.004}
    endless = splits.spectrophotometer(splits.Snow(depth_m=math.inf), seed=6, **light)
    enough = endless.attrs["semi_infinite_depth_m"]
    finite = splits.spectrophotometer(splits.Snow(depth_m=enough), seed=7, **light)
    error = np.hypot(endless.reflectance_stderr, finite.reflectance_stderr)
    off = np.abs(endless.reflectance - finite.reflectance)
    assert (off <= 0.004 + 3.0 * error).all()
    assert (endless.transmittance == 0.0).all()


def test_faces_reflect_diffuse_light_as_the_closed_form_says():
    """Walsh's integral of Fresnel's reflectance, for n > 1; reciprocity for the way back."""
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


def test_diffusion_below_a_cut_has_its_limits():
    """Nothing absorbed: 1/(2 + h/D) through to a black bottom; a white one sends all back."""
    one = np.ones(1)
    diffusion, height = 1e-4, 0.5
    rate = 1e-8
    black = DiffusiveSubstrate(rate * diffusion * one, rate * height * one, 0.5 * one)
    expected = 1.0 / (2.0 + height / diffusion)
    assert black.compute_flux_ratio() == pytest.approx(expected, rel=1e-9)
    assert black.compute_transmitted_fraction() == pytest.approx(1.0, rel=1e-9)
    white = DiffusiveSubstrate(rate * diffusion * one, rate * height * one, 0.0 * one)
    assert white.compute_reflected_fraction() == pytest.approx(1.0, abs=1e-9)
    endless = DiffusiveSubstrate(0.3 * one, math.inf * one, 0.5 * one)
    assert endless.compute_flux_ratio() == pytest.approx(0.3)
    assert endless.compute_transmitted_fraction() == 0.0
    thick, thin = (DiffusiveSubstrate(0.3 * one, h * one, 0.5 * one) for h in (30.0, 1e-12))
    assert thick.compute_reflected_fraction() == pytest.approx(endless.compute_reflected_fraction())
    assert thin.compute_reflected_fraction() == pytest.approx(0.0, abs=1e-9)
    assert thin.compute_transmitted_fraction() == pytest.approx(1.0)


@pytest.mark.parametrize(
    "instrument",
    [
        lambda snow: splits.goniophotometer(snow, [500.0]),
        lambda snow: splits.beam_spread(snow, [500.0]),
        lambda snow: splits.deep_transmittance(snow, [500.0]),
        lambda snow: splits.spectrophotometer(snow, [500.0], estimator="analog"),
    ],
)
def test_other_instruments_refuse_packs_without_end(instrument):
    with pytest.raises(InvalidValue, match="depth_m = inf: must be finite"):
        instrument(splits.Snow(depth_m=math.inf))


def test_only_the_lowest_layer_has_no_end():
    endless = splits.Snow(depth_m=math.inf)
    assert splits.Stack([splits.Snow(), endless]).depth_m == math.inf
    with pytest.raises(InvalidValue, match=r"layers\[0\].depth_m = inf: must be finite"):
        splits.Stack([endless, splits.Snow()])
