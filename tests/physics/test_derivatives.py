"""Derivatives of spectra against differences of runs with random numbers of their own."""

from __future__ import annotations

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z

import splits
from splits.core.validation import InvalidValue
from splits.media.parameters import (
    get_derivative_unit,
    get_parameter,
    list_parameters,
    replace_parameter,
)
from splits.simulation.estimators import SpectralEstimate
from splits.simulation.finite_differences import (
    _compute_difference_weights,
    _compute_stencil_weights,
    compute_finite_difference,
)
from splits.simulation.path_tally import Derivatives

W = [450.0, 850.0, 1250.0]
THIN = splits.Snow.natural(
    optical_radius_um=150, depth_m=0.01, density_kg_m3=200, ground=0.3,
    impurities_ng_g={"black_carbon": 200},
)  # fmt: skip
DEEP = splits.Snow.natural(optical_radius_um=150, impurities_ng_g={"black_carbon": 200})
SAND = splits.Sand(hematite_ratio=0.3, saturation=0.3)
LAYER = splits.ParticleLayer(optical_thickness=2)
CASES = {
    "ground": (THIN, "ground", 0.1, "shared_paths"),
    "size below ground": (THIN, "optical_radius_um", 20.0, "finite_difference"),
    "density": (THIN, "density_kg_m3", 25.0, "finite_difference"),
    "shape": (THIN, "sphericity", 0.05, "finite_difference"),
    "size of deep snow": (DEEP, "optical_radius_um", 30.0, "shared_paths"),
    "area of deep snow": (DEEP, "specific_surface_area_m2_kg", 4.0, "shared_paths"),
    "iron oxide": (SAND, "iron_oxide", 0.002, "finite_difference"),
    "coated grains": (SAND, "partition.coated", 0.08, "finite_difference"),
    "optical thickness": (LAYER, "optical_thickness", 0.3, "finite_difference"),
    "asymmetry": (LAYER, "asymmetry", 0.03, "finite_difference"),
}


def places(medium):
    """Return the wavelengths of a medium; a layer has no colour."""
    return W[:1] if medium.kind == "particle_layer" else W


def central(medium, name, step, error):
    """Return a five-point difference of independent runs, and its error."""
    value, square = 0.0, 0.0
    for seed, (place, weight) in enumerate({-2: 1, -1: -8, 1: 8, 2: -1}.items(), start=100):
        other = replace_parameter(medium, name, get_parameter(medium, name) + place * step)
        run = splits.spectrophotometer(other, places(medium), 30, error, seed)
        share = weight / (12.0 * step)
        value = value + share * run.reflectance.values
        square = square + (share * run.reflectance_stderr.values) ** 2
    return value, np.sqrt(square)


@NEEDS_JIT
def test_derivatives_are_those_of_independent_runs():
    z = []
    for medium, name, step, method in CASES.values():
        found = splits.spectrophotometer(medium, places(medium), 30, 0.004, jacobian=[name])
        assert found.parameter_method.values.tolist() == [method]
        value, error = central(medium, name, step, 0.004)
        own, own_error = (found[f"reflectance_jacobian{end}"].values[0] for end in ("", "_stderr"))
        z.append((own - value) / np.hypot(own_error, error))
    # Wavelengths of a case share their rays: of each case one counts, the darkest.
    judge_z(np.array([row[-1] for row in z]), bound_added=True)


@NEEDS_JIT
def test_derivatives_stand_in_the_order_asked_for():
    asked = ["density_kg_m3", "ground", "incidence_deg"]
    found = splits.spectrophotometer(THIN, [850.0], 30, 0.05, jacobian=asked)
    assert found.parameter.values.tolist() == asked
    assert found.parameter_method.values.tolist() == [
        "finite_difference",
        "shared_paths",
        "finite_difference",
    ]
    assert found.parameter_unit.values.tolist() == ["m3 kg-1", "1", "degree-1"]
    for i, name in enumerate(asked):
        alone = splits.spectrophotometer(THIN, [850.0], 30, 0.05, jacobian=[name])
        assert float(alone.reflectance_jacobian[0, 0]) == float(found.reflectance_jacobian[i, 0])
    assert found.attrs["finite_difference_rays"] > 0


@pytest.mark.parametrize("offsets", [(-2, -1, 1, 2), (-1.5, -0.5, 1.5, 2.5), (0, 1, 3, 4)])
def test_rules_are_exact_for_cubics(offsets):
    fine, coarse = _compute_stencil_weights(tuple(map(float, offsets)), 0.1)
    x = 0.1 * np.array(offsets)
    for power in range(4):
        exact = 1.0 if power == 1 else 0.0
        assert fine @ x**power == pytest.approx(exact, abs=1e-9)
        if power < 3:
            assert coarse @ x**power == pytest.approx(exact, abs=1e-9)


def test_weights_of_the_five_point_rule():
    weights = _compute_difference_weights(np.array([-2.0, -1.0, 1.0, 2.0]))
    np.testing.assert_allclose(weights, np.array([1, -8, 8, -1]) / 12.0, atol=1e-12)


@pytest.mark.parametrize(
    "medium",
    [
        THIN,
        splits.Sand(texture=(0.01, 0.1, 0.89)),
        LAYER,
        splits.Stack([splits.Snow(depth_m=0.01), splits.Snow()]),
    ],
)
def test_every_parameter_can_be_moved(medium):
    for name in list_parameters(medium):
        before = get_parameter(medium, name)
        step = -1e-3 if name in ("max_polarization",) else 1e-3
        after = replace_parameter(medium, name, before + step)
        assert get_parameter(after, name) - before == pytest.approx(step, abs=1e-9)
        assert isinstance(get_derivative_unit(name), str)


def test_shares_leave_the_others_in_their_ratios():
    sand = splits.Sand(partition=(0.5, 0.3, 0.2))
    moved = replace_parameter(sand, "partition.coated", 0.6)
    assert moved.partition == pytest.approx((0.25, 0.15, 0.6))
    with pytest.raises(InvalidValue, match=r"partition\.pure = 1\.2: must be in \[0, 1\]"):
        replace_parameter(sand, "partition.pure", 1.2)
    with pytest.raises(InvalidValue, match="below 1 to begin with"):
        replace_parameter(splits.Sand(partition=(0.0, 1.0, 0.0)), "partition.mixed", 0.5)
    with pytest.raises(InvalidValue, match="silt"):
        get_parameter(sand, "texture.sild")


LAWS = {
    "falling": (lambda s: 0.5 * np.exp(-5.0 * s), -2.5),
    "steep": (lambda s: 0.5 * np.exp(-10.0 * s), -5.0),
    "root": (lambda s: 0.8 * np.exp(-1.5 * np.sqrt(0.02 + s)), -3.431),
    "sharp root": (lambda s: 0.8 * np.exp(-1.5 * np.sqrt(1e-4 + s)), -59.107),
}


def formula(make, noise):
    """Return runs of a medium whose reflectance is a function of its saturation."""

    def measure(medium, _incidence):
        mean = np.array([[make(medium.saturation)], [0.0], [0.0]])
        groups = np.full((32, 2, 1), noise / np.sqrt(32.0))
        none = np.zeros((2, 0, 1))
        return SpectralEstimate(
            mean, noise + 0.0 * mean, 0.0 * mean, groups, 1, 1, True, "vectorized",
            Derivatives(none, np.zeros((32, *none.shape)), none),
        )  # fmt: skip

    return measure


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("noise", [1e-3, 1e-5])
def test_one_sided_differences_say_how_far_they_are_off(law, noise):
    """Where a range begins, without noise in the means: what is left is the rule's own."""
    make, slope = LAWS[law]
    found = compute_finite_difference(
        formula(make, noise), splits.Snow(saturation=0.0), 0.0, "saturation"
    ).derivatives
    assert abs(found.mean[0, 0, 0] - slope) < 2.0 * found.stderr[0, 0, 0] + 2e-3


@pytest.mark.parametrize("saturation", [1e-3, 0.01, 0.2])
def test_a_root_has_its_slope_wherever_it_has_one(saturation):
    def root(s):
        return 0.5 - 0.2 * np.sqrt(2.0 * s)

    snow = splits.Snow(saturation=saturation)
    found = compute_finite_difference(formula(root, 1e-4), snow, 0.0, "saturation").derivatives
    slope = -0.2 / np.sqrt(2.0 * saturation)
    assert found.mean[0, 0, 0] == pytest.approx(slope, rel=1e-3)
    with pytest.raises(InvalidValue, match=r"saturation\) = 0\.0: must be where .* is finite"):
        compute_finite_difference(
            formula(root, 1e-6), splits.Snow(saturation=0.0), 0.0, "saturation"
        )


def test_an_albedo_near_one_has_its_slope():
    """Reflectance of a thick layer goes as the root of what absorbs."""

    def make(albedo):
        return np.exp(-3.0 * np.sqrt(1.0 - albedo + 1e-4))

    layer = splits.ParticleLayer(single_scattering_albedo=0.999)

    def measure(medium, incidence):
        known = splits.Snow(saturation=0.5)
        value = make(medium.single_scattering_albedo)
        return formula(lambda _: value, 1e-4)(known, incidence)

    found = compute_finite_difference(measure, layer, 0.0, "single_scattering_albedo").derivatives
    exact = make(0.999) * 1.5 / np.sqrt(1e-3 + 1e-4)
    off = abs(found.mean[0, 0, 0] - exact)
    assert off < 2.0 * found.stderr[0, 0, 0] + 1e-2 * exact
