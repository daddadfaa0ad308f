"""Derivatives of spectra against finite differences of independent runs."""

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
from splits.simulation.derivatives import (
    _compute_stencil_weights,
    compute_difference_weights,
    compute_finite_difference,
)
from splits.simulation.spectral_tally import Derivatives, SpectralEstimate

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


def select_wavelengths(medium):
    """Return the wavelengths for a medium; particle layers do not depend on wavelength."""
    return W[:1] if medium.kind == "particle_layer" else W


def compute_central_difference(medium, name, step, error):
    """Return a five-point difference of independent runs and its standard error."""
    value, variance = 0.0, 0.0
    for seed, (offset, weight) in enumerate({-2: 1, -1: -8, 1: 8, 2: -1}.items(), start=100):
        shifted = replace_parameter(medium, name, get_parameter(medium, name) + offset * step)
        run = splits.spectrophotometer(
            shifted,
            select_wavelengths(medium),
            30,
            max_stderr=error,
            seed=seed,
            solver="monte_carlo",
        )
        coefficient = weight / (12.0 * step)
        value = value + coefficient * run.reflectance.values
        variance = variance + (coefficient * run.reflectance_stderr.values) ** 2
    return value, np.sqrt(variance)


@pytest.mark.long
@NEEDS_JIT
def test_derivatives_agree_with_independent_runs():
    z = []
    for medium, name, step, method in CASES.values():
        run = splits.spectrophotometer(
            medium,
            select_wavelengths(medium),
            30,
            max_stderr=0.004,
            jacobian=[name],
            solver="monte_carlo",
        )
        assert run.parameter_method.values.tolist() == [method]
        value, error = compute_central_difference(medium, name, step, 0.004)
        derivative, derivative_error = (
            run[f"reflectance_jacobian{end}"].values[0] for end in ("", "_stderr")
        )
        z.append((derivative - value) / np.hypot(derivative_error, error))
    # Wavelengths of a case use the same rays, so only the most absorbing one of each case counts.
    judge_z(np.array([row[-1] for row in z]), bound_added=True)


@pytest.mark.long
@NEEDS_JIT
def test_derivatives_keep_the_requested_order():
    names = ["density_kg_m3", "ground", "incidence_deg"]
    run = splits.spectrophotometer(
        THIN, [850.0], 30, max_stderr=0.05, jacobian=names, solver="monte_carlo"
    )
    assert run.parameter.values.tolist() == names
    assert run.parameter_method.values.tolist() == [
        "finite_difference",
        "shared_paths",
        "finite_difference",
    ]
    assert run.parameter_unit.values.tolist() == ["m3 kg-1", "1", "degree-1"]
    for i, name in enumerate(names):
        single = splits.spectrophotometer(
            THIN, [850.0], 30, max_stderr=0.05, jacobian=[name], solver="monte_carlo"
        )
        assert float(single.reflectance_jacobian[0, 0]) == float(run.reflectance_jacobian[i, 0])
    assert run.attrs["finite_difference_rays"] > 0


@pytest.mark.parametrize("offsets", [(-2, -1, 1, 2), (-1.5, -0.5, 1.5, 2.5), (0, 1, 3, 4)])
def test_stencils_are_exact_for_cubics(offsets):
    fine, coarse = _compute_stencil_weights(tuple(map(float, offsets)), 0.1)
    x = 0.1 * np.array(offsets)
    for power in range(4):
        exact = 1.0 if power == 1 else 0.0
        assert fine @ x**power == pytest.approx(exact, abs=1e-9)
        if power < 3:
            assert coarse @ x**power == pytest.approx(exact, abs=1e-9)


def test_five_point_stencil_has_the_known_weights():
    weights = compute_difference_weights(np.array([-2.0, -1.0, 1.0, 2.0]))
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
def test_every_parameter_can_be_replaced(medium):
    for name in list_parameters(medium):
        before = get_parameter(medium, name)
        after = replace_parameter(medium, name, before + 1e-3)
        assert get_parameter(after, name) - before == pytest.approx(1e-3, abs=1e-9)
        assert isinstance(get_derivative_unit(name), str)


def test_fractions_keep_the_ratios_of_the_others():
    sand = splits.Sand(partition=(0.5, 0.3, 0.2))
    moved = replace_parameter(sand, "partition.coated", 0.6)
    assert moved.partition == pytest.approx((0.25, 0.15, 0.6))
    with pytest.raises(InvalidValue, match=r"partition\.pure = 1\.2: must be in \[0, 1\]"):
        replace_parameter(sand, "partition.pure", 1.2)
    with pytest.raises(InvalidValue, match="below 1 to begin with"):
        replace_parameter(splits.Sand(partition=(0.0, 1.0, 0.0)), "partition.mixed", 0.5)
    with pytest.raises(InvalidValue, match="silt"):
        get_parameter(sand, "texture.sild")


FUNCTIONS = {
    "falling": (lambda s: 0.5 * np.exp(-5.0 * s), -2.5),
    "steep": (lambda s: 0.5 * np.exp(-10.0 * s), -5.0),
    "root": (lambda s: 0.8 * np.exp(-1.5 * np.sqrt(0.02 + s)), -3.431),
    "sharp root": (lambda s: 0.8 * np.exp(-1.5 * np.sqrt(1e-4 + s)), -59.107),
}


def make_estimator(function, noise):
    """Return runs of a medium whose reflectance is a function of its saturation."""

    def measure(medium, _incidence):
        mean = np.array([[function(medium.saturation)], [0.0], [0.0]])
        batches = np.full((32, 2, 1), noise / np.sqrt(32.0))
        empty = np.zeros((2, 0, 1))
        return SpectralEstimate(
            mean, noise + 0.0 * mean, 0.0 * mean, batches,
            Derivatives(empty, np.zeros((32, *empty.shape)), empty), np.zeros(1), {"rays": 1},
        )  # fmt: skip

    return measure


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("noise", [1e-3, 1e-5])
def test_one_sided_differences_state_their_error(name, noise):
    """At the edge of a range and without noise in the means, the error is that of the stencil."""
    function, slope = FUNCTIONS[name]
    derivatives, _ = compute_finite_difference(
        make_estimator(function, noise), splits.Snow(saturation=0.0), 0.0, "saturation"
    )
    assert abs(derivatives.mean[0, 0, 0] - slope) < 2.0 * derivatives.stderr[0, 0, 0] + 2e-3


@pytest.mark.parametrize("saturation", [1e-3, 0.01, 0.2])
def test_derivative_of_a_square_root_is_found_where_finite(saturation):
    def root(s):
        return 0.5 - 0.2 * np.sqrt(2.0 * s)

    snow = splits.Snow(saturation=saturation)
    derivatives, _ = compute_finite_difference(make_estimator(root, 1e-4), snow, 0.0, "saturation")
    slope = -0.2 / np.sqrt(2.0 * saturation)
    assert derivatives.mean[0, 0, 0] == pytest.approx(slope, rel=1e-3)
    with pytest.raises(InvalidValue, match=r"saturation\) = 0\.0: must be where .* is finite"):
        compute_finite_difference(
            make_estimator(root, 1e-6), splits.Snow(saturation=0.0), 0.0, "saturation"
        )


def test_derivative_near_albedo_one_is_accurate():
    """The reflectance of a thick layer varies with the square root of 1 − albedo."""

    def reflectance(albedo):
        return np.exp(-3.0 * np.sqrt(1.0 - albedo + 1e-4))

    layer = splits.ParticleLayer(single_scattering_albedo=0.999)

    def measure(medium, incidence):
        placeholder = splits.Snow(saturation=0.5)
        value = reflectance(medium.single_scattering_albedo)
        return make_estimator(lambda _: value, 1e-4)(placeholder, incidence)

    derivatives, _ = compute_finite_difference(measure, layer, 0.0, "single_scattering_albedo")
    exact = reflectance(0.999) * 1.5 / np.sqrt(1e-3 + 1e-4)
    deviation = abs(derivatives.mean[0, 0, 0] - exact)
    assert deviation < 2.0 * derivatives.stderr[0, 0, 0] + 1e-2 * exact


@NEEDS_JIT
def test_noise_of_similar_media_is_common():
    """Retrievals by simulation and finite differences rely on common random numbers."""
    sands = [splits.Sand(iron_oxide=iron_oxide) for iron_oxide in (0.015, 0.0153)]
    base, shifted = (
        np.array([
            splits.spectrophotometer(
                sand, [500.0, 800.0], max_stderr=0.02, solver="monte_carlo", seed=seed
            ).reflectance.values
            for seed in range(12)
        ])
        for sand in sands
    )  # fmt: skip
    common = (shifted - base).var(axis=0, ddof=1).sum()
    independent = (shifted.var(axis=0, ddof=1) + base.var(axis=0, ddof=1)).sum()
    assert independent > 5.0 * common
