"""Media that share paths: bits, independent runs, and derivatives against differences."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits
from splits.core.validation import InvalidValue

WAVELENGTHS = np.array([400.0, 450.0, 550.0, 700.0, 850.0, 1000.0])
SOOT = "impurities_ng_g.black_carbon"
CONCENTRATIONS = (0.0, *np.geomspace(5.0, 5000.0, 19))
PLACES = {
    "thin over soil": {"depth_m": 0.05, "ground": 0.3},
    "open below": {"depth_m": 0.05},
    "deep": {},
    "in pores": {"depth_m": 0.05, "impurities_in": "pores"},
}


def snow(soot: float, **place) -> splits.Snow:
    """Return natural snow with so much black carbon (ng/g)."""
    given = {"specific_surface_area_m2_kg": 20.0, "density_kg_m3": 250.0} | place
    return splits.Snow.natural(**given, impurities_ng_g={"black_carbon": soot})


def soiled(amounts, **place) -> dict[str, splits.Snow]:
    """Return snow with one concentration after the other."""
    return {f"{soot:g}": snow(soot, **place) for soot in amounts}


@NEEDS_JIT
@pytest.mark.parametrize("kernel", ["vectorized", "scalar"])
@pytest.mark.parametrize("place", ["thin over soil", "in pores", "deep"])
def test_bits_do_not_depend_on_who_else_shares_the_paths(place, kernel):
    """Twenty concentrations at once, against each of them beside the clean snow alone."""
    asked = {"max_stderr": 0.5, "kernel": kernel, "seed": 3}
    together = splits.spectrophotometer(
        soiled(CONCENTRATIONS, **PLACES[place]), WAVELENGTHS, **asked
    )
    for name, soot in zip(together.medium.values, CONCENTRATIONS, strict=True):
        pair = splits.spectrophotometer(soiled((0.0, soot), **PLACES[place]), WAVELENGTHS, **asked)
        assert pair.rays == together.rays
        for quantity in ("reflectance", "transmittance", "absorptance"):
            one = pair[quantity].sel(medium=f"{soot:g}").values
            assert np.array_equal(together[quantity].sel(medium=name).values, one), (name, quantity)


@NEEDS_JIT
@pytest.mark.parametrize("error", [0.005, pytest.param(0.003, marks=pytest.mark.long)])
@pytest.mark.parametrize("place", PLACES)
def test_twenty_concentrations_against_runs_of_their_own(place, error):
    """Each with a seed of its own; those that share paths go together, so they count as one.

    At 0.003 one reflectance off by 0.04 is seen, and all of them by 0.009, in 99 of 100 cases:
    what they share, with the smaller error, is told far better than what twenty runs add to it.
    """
    where = PLACES[place]
    together = splits.spectrophotometer(
        soiled(CONCENTRATIONS, **where), WAVELENGTHS, max_stderr=error
    )
    z = []
    for number, (name, medium) in enumerate(soiled(CONCENTRATIONS, **where).items()):
        own = splits.spectrophotometer(
            medium, WAVELENGTHS, max_stderr=2.0 * error, seed=100 + number
        )
        shared = together.sel(medium=name)
        both = np.hypot(shared.reflectance_stderr, own.reflectance_stderr)
        z.append(((shared.reflectance - own.reflectance) / both).values)
    judge_z(np.array(z), place, independent=len(WAVELENGTHS), bound_added=True)


SEEDS = 6


def away(found, others, quantity, number, less, more, step):
    """Return a derivative less the difference between two media, and the error of that."""
    values, groups = others[quantity], others[f"{quantity}_batches"]
    difference = (values.sel(medium=more) - values.sel(medium=less)) / step
    error = np.sqrt(
        (((groups.sel(medium=more) - groups.sel(medium=less)) / step) ** 2).sum("batch")
    )
    stated = found[f"{quantity}_jacobian_stderr"][number].values
    slope = found[f"{quantity}_jacobian"][number].values
    return slope - difference.values, np.hypot(stated, error.values)


@NEEDS_JIT
@pytest.mark.parametrize("error", [0.004, pytest.param(0.002, marks=pytest.mark.long)])
@pytest.mark.parametrize("place", PLACES)
def test_derivatives_against_differences_of_shared_paths(place, error):
    """To black carbon and to algae: a derivative's own paths, and others for the difference."""
    where = PLACES[place]
    media = soiled((190.0, 210.0), **where)
    media |= {
        f"algae {cells:g}": splits.Snow.natural(
            specific_surface_area_m2_kg=20.0, density_kg_m3=250.0, **where,
            impurities_ng_g={"black_carbon": 200.0}, algae_cells_ml={"snow_algae": cells},
        )
        for cells in (0.0, 40.0)
    }  # fmt: skip
    bands = WAVELENGTHS[WAVELENGTHS < 750.0]
    off, squares = [], []
    # Rare long paths make errors of single runs uneven: means over several are judged.
    for seed in range(SEEDS):
        found = splits.spectrophotometer(
            snow(200.0, **where), bands, max_stderr=error, seed=100 + seed,
            jacobian=[SOOT, "algae_cells_ml.snow_algae"],
        )  # fmt: skip
        others = splits.spectrophotometer(media, bands, max_stderr=error, seed=200 + seed)
        one = [
            away(found, others, quantity, number, *ends)
            for quantity in ("reflectance", "transmittance")
            if quantity == "reflectance" or float(found.transmittance.max()) > 1e-3
            for number, ends in enumerate([("190", "210", 20.0), ("algae 0", "algae 40", 40.0)])
        ]
        off.append([difference for difference, _ in one])
        squares.append([stated**2 for _, stated in one])
    z = np.mean(off, axis=0) / np.sqrt(np.mean(squares, axis=0) / SEEDS)
    judge_z(z, place, independent=len(bands), bound_added=True)


CLEAR = {"specific_surface_area_m2_kg": 20.0, "refractive_index": {"ice": 1.31}, "depth_m": 3.0}
"""A pack so deep that it is cut; nothing in it absorbs."""
GREY = {"specific_surface_area_m2_kg": 20.0, "refractive_index": {"ice": "warren_brandt_2008"}}


@NEEDS_JIT
@pytest.mark.parametrize(
    ("pack", "amount"), [(CLEAR, 1e-3), (GREY | {"impurities_in": "pores"}, 1e-3)]
)
def test_derivatives_where_what_would_hold_the_impurity_does_not_absorb(pack, amount):
    """The rest of a cut pack goes as the root of its absorption: held against the same paths."""
    clean, dirty = (
        splits.Snow.natural(**pack, impurities_ng_g={"black_carbon": ng}) for ng in (0.0, amount)
    )
    asked = {"max_stderr": 0.01, "seed": 5}
    found = splits.spectrophotometer(clean, [400.0, 500.0], jacobian=[SOOT], **asked)
    both = splits.spectrophotometer({"clean": clean, "dirty": dirty}, [400.0, 500.0], **asked)
    for quantity in ("reflectance", "transmittance"):
        slope = found[f"{quantity}_jacobian"][0].values
        change = (both[quantity][1] - both[quantity][0]).values / amount
        np.testing.assert_allclose(slope, change, rtol=0.02, atol=1e-9)


@NEEDS_JIT
def test_errors_of_derivatives_are_what_seeds_scatter_by():
    """Forty seeds; wavelengths and parameters share paths, so they count as one comparison."""
    runs = [
        splits.spectrophotometer(
            snow(100.0, depth_m=0.05), [450.0, 700.0], max_stderr=0.02, seed=seed, jacobian=[SOOT]
        )
        for seed in range(40)
    ]
    slopes = np.array([run.reflectance_jacobian.values[0] for run in runs])
    groups = np.array([run.reflectance_jacobian_batches.values[:, 0] for run in runs])
    stated = (groups**2).sum(axis=1).mean(axis=0)
    z = (slopes - slopes.mean(axis=0)) / np.sqrt(stated * (1.0 - 1.0 / len(runs)))
    judge_z(z, independent=len(runs))


@NEEDS_JIT
def test_a_layer_of_a_stack_has_derivatives_of_its_own():
    """What its soot does, and what the same soot does below: less."""
    stack = splits.Stack([snow(50.0, depth_m=0.02), snow(50.0, depth_m=0.1)], ground=0.2)
    names = [f"layers.{number}.{SOOT}" for number in (0, 1)]
    found = splits.spectrophotometer(stack, [450.0, 600.0], max_stderr=0.005, jacobian=names)
    assert list(found.parameter.values) == names
    top, below = found.reflectance_jacobian.values
    error = found.reflectance_jacobian_stderr.values
    assert (top < -5.0 * error[0]).all()
    assert (below < -5.0 * error[1]).all()
    both = [
        splits.Stack([snow(s, depth_m=0.02), snow(s, depth_m=0.1)], ground=0.2)
        for s in (40.0, 60.0)
    ]
    more = splits.spectrophotometer(
        dict(zip("ab", both, strict=True)), [450.0, 600.0], max_stderr=0.005
    )
    difference = (more.reflectance[1] - more.reflectance[0]).values / 20.0
    off = (more.reflectance_batches[:, 1] - more.reflectance_batches[:, 0]).values / 20.0
    noise = np.sqrt((off**2).sum(axis=0) + error[0] ** 2 + error[1] ** 2)
    judge_z((top + below - difference) / noise, independent=1, bound_added=True)


def test_grounds_of_several_albedos_share_paths():
    """A ground absorbs at a bounce, as soot does along a leg."""
    media = {f"{a}": snow(0.0, depth_m=0.01, ground=a) for a in (0.2, 0.8)}
    found = splits.spectrophotometer(media, [500.0, 900.0], max_stderr=0.05)
    assert (found.reflectance[1] > found.reflectance[0]).all()
    assert found.snow_black_carbon_ng_g == 0.0


BASE = snow(0.0, depth_m=0.05)
WRONG = {
    "other grains": (
        {"a": BASE, "b": splits.Snow(depth_m=0.05)},
        r"medium\['b'\] = 'snow': must be",
    ),
    "other depth": ({"a": BASE, "b": snow(0.0, depth_m=0.1)}, r"medium\['b'\]"),
    "a ground": ({"a": BASE, "b": snow(0.0, depth_m=0.05, ground=0.5)}, r"medium\['b'\]"),
    "another kind": ({"a": BASE, "b": splits.Sand(depth_m=0.05)}, r"medium\['b'\] = 'sand'"),
    "a layer": ({"a": splits.ParticleLayer(optical_thickness=1)}, "granular medium"),
    "none": ({}, "at least one"),
    "a list": ([BASE], r"must be splits.Snow"),
}


@pytest.mark.parametrize("name", WRONG)
def test_media_that_do_not_share_paths_are_invalid(name):
    media, message = WRONG[name]
    with pytest.raises(InvalidValue, match=message):
        splits.spectrophotometer(media, [500.0], max_stderr=0.1)


STACK = splits.Stack([BASE, BASE])
UNKNOWN = {
    "unknown kind": (BASE, ["impurities_ng_g.soot"], "black_carbon"),
    "unknown key": (BASE, ["optical_radius"], "did you mean optical_radius_um"),
    "a range": (BASE, ["grain_size_um"], "unknown key"),
    "an open ground": (BASE, ["ground"], "unknown key"),
    "no end": (splits.Snow.natural(optical_radius_um=100), ["depth_m"], "finite value"),
    "diffuse": (BASE, ["incidence_deg"], "of a beam"),
    "a layer of none": (BASE, [f"layers.0.{SOOT}"], "not a stack"),
    "no layer": (STACK, [SOOT], r"layers.0 to layers.1"),
    "far layer": (STACK, [f"layers.2.{SOOT}"], r"layers.0 to layers.1"),
    "sand": (splits.Sand(), [SOOT], "with impurities"),
    "a layer": (splits.ParticleLayer(optical_thickness=1), [SOOT], "with impurities"),
    "twice": (BASE, [SOOT, SOOT], "named once"),
    "text": (BASE, SOOT, "a list of parameters"),
    "algae by mass": (BASE, ["impurities_ng_g.snow_algae"], "snow_algae"),
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_derivatives_that_do_not_exist_are_refused(name):
    medium, jacobian, message = UNKNOWN[name]
    with pytest.raises(InvalidValue, match=message):
        light = "diffuse" if "incidence_deg" in jacobian else 0.0
        splits.spectrophotometer(medium, [500.0], light, max_stderr=0.1, jacobian=jacobian)


def test_derivatives_need_shared_paths():
    with pytest.raises(InvalidValue, match="left out for this estimator"):
        splits.spectrophotometer(BASE, [500.0], estimator="analog", jacobian=[SOOT])


@NEEDS_JIT
def test_deep_packs_that_absorb_nothing_have_no_derivative():
    """There the reflectance falls with the root of what is added."""
    clear = splits.Snow.natural(
        specific_surface_area_m2_kg=20, refractive_index={"ice": 1.31, "water": 1.33}
    )
    with pytest.raises(InvalidValue, match="where nothing absorbs"):
        splits.spectrophotometer(clear, [500.0], max_stderr=0.01, jacobian=[SOOT])
