"""Discrete ordinates and asymptotic theory: exact results, propagated errors, and a table."""

import itertools
import math

import numpy as np
import pytest
import snowoptics
import xarray as xr
from formula_tables import make_table

from splits.analysis.theory.kokhanovsky_zege import make_law_table
from splits.analysis.theory.spectra import (
    compute_interpolation_bound,
    compute_shape_factors,
    correct_dense_packing,
    kz04,
    propagate_errors,
    solve_discrete_ordinates,
)
from splits.core.validation import InvalidValue
from splits.materials.impurities import make_impurities

WAVELENGTHS = np.array([500.0, 900.0, 1030.0])


def make_layer_optics(albedo, thickness, g=0.0, orders=65):
    """Return optics of a layer with the phase function of Henyey & Greenstein (1941)."""
    moments = np.tile(float(g) ** np.arange(orders), (len(albedo), 1))
    n_wavelengths = len(albedo)
    return xr.Dataset(
        {
            "single_scattering_albedo": ("wavelength", np.asarray(albedo, dtype=float)),
            "asymmetry_parameter": ("wavelength", np.full(n_wavelengths, float(g))),
            "optical_thickness": ("wavelength", np.full(n_wavelengths, float(thickness))),
            "legendre_moment": (("wavelength", "order"), moments),
        },
        {"wavelength": 500.0 + np.arange(n_wavelengths)},
    )


def compute_plane_albedo(albedo, cosine):
    """Return 1 − H(μ) √(1 − ω), the plane albedo of an isotropic half-space (Chandrasekhar)."""
    x, w = np.polynomial.legendre.leggauss(200)
    mu, w = 0.5 * (x + 1.0), 0.5 * w
    root = math.sqrt(1.0 - albedo)

    def evaluate_h(points, h):
        kernel = w * mu * h / (np.atleast_1d(points)[:, np.newaxis] + mu)
        return 1.0 / (root + 0.5 * albedo * kernel.sum(axis=1))

    h = np.ones_like(mu)
    for _ in range(500):
        h = 0.5 * (h + evaluate_h(mu, h))
    return 1.0 - root * float(evaluate_h(cosine, h)[0])


@pytest.mark.parametrize("incidence", [0.0, 60.0])
def test_isotropic_half_space_matches_chandrasekhar(incidence):
    albedo = [0.5, 0.9, 0.99]
    ds = solve_discrete_ordinates(make_layer_optics(albedo, 1000.0), incidence)
    expected = [compute_plane_albedo(a, math.cos(math.radians(incidence))) for a in albedo]
    assert ds.reflectance.values == pytest.approx(expected, abs=2e-5)
    assert np.abs(ds.transmittance).max() < 1e-6


@pytest.mark.parametrize("incidence", [0.0, 75.0, "diffuse"])
def test_energy_is_conserved_without_absorption(incidence):
    for thickness in (0.1, 10.0, 300.0):
        ds = solve_discrete_ordinates(make_layer_optics([1.0], thickness, 0.8), incidence)
        assert float((ds.reflectance + ds.transmittance)[0]) == pytest.approx(1.0, abs=2e-5)


def test_pure_forward_scattering_is_transmitted():
    ds = solve_discrete_ordinates(make_layer_optics([1.0, 0.5], 2.0, 1.0))
    assert ds.reflectance.values == pytest.approx(0.0, abs=1e-6)
    assert ds.transmittance.values == pytest.approx([1.0, math.exp(-1.0)], abs=1e-6)


def test_truncation_error_bounds_the_effect_of_streams():
    optics = make_layer_optics([0.999], 5.0, 0.85)
    coarse, fine = (solve_discrete_ordinates(optics, 30.0, streams) for streams in (16, 64))
    for name in ("reflectance", "transmittance"):
        assert np.abs(coarse[name] - fine[name]).max() <= coarse[f"{name}_truncation"].max()


@pytest.mark.parametrize("incidence", [30.0, "diffuse"])
def test_a_divided_layer_gives_the_same_result(incidence):
    undivided = solve_discrete_ordinates(
        make_layer_optics([0.99, 0.9], 3.0, 0.7), incidence, ground=0.4
    )
    layers = [make_layer_optics([0.99, 0.9], thickness, 0.7) for thickness in (0.5, 1.5, 1.0)]
    divided = solve_discrete_ordinates(layers, incidence, ground=0.4)
    for name in ("reflectance", "transmittance"):
        np.testing.assert_allclose(divided[name], undivided[name], rtol=0.0, atol=1e-9)


def test_multiple_reflections_between_layers_and_ground():
    layers = [make_layer_optics([0.99], 1.0, 0.8), make_layer_optics([0.8], 0.5, 0.3)]
    beam, below = (
        solve_discrete_ordinates(layers, 40.0),
        solve_discrete_ordinates(layers[::-1], "diffuse"),
    )
    for albedo in (0.1, 0.5, 1.0):
        result = solve_discrete_ordinates(layers, 40.0, ground=albedo)
        series = beam.transmittance / (1.0 - albedo * below.reflectance)
        expected = beam.reflectance + series * albedo * below.transmittance
        assert float(result.reflectance[0]) == pytest.approx(float(expected[0]), abs=1e-6)
        absorbed = (1.0 - albedo) * float(series[0])
        assert float(result.transmittance[0]) == pytest.approx(absorbed, abs=1e-6)


def test_layers_must_have_the_same_wavelengths():
    other = make_layer_optics([0.9], 1.0).assign_coords(wavelength=[700.0])
    with pytest.raises(ValueError, match=r"optics\[1\].wavelength"):
        solve_discrete_ordinates([make_layer_optics([0.9], 1.0), other])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"streams": 5}, "streams = 5"),
        ({"streams": 66}, "streams = 66"),
        ({"incidence_deg": 90.0}, "incidence_deg"),
        ({"incidence_deg": "sky"}, "incidence_deg"),
    ],
)
def test_invalid_settings_are_rejected_by_name(settings, message):
    with pytest.raises(ValueError, match=message):
        solve_discrete_ordinates(make_layer_optics([0.9], 1.0), **settings)


def test_half_space_matches_snowoptics():
    for incidence, diffuse_fraction in ((30.0, 0.0), ("diffuse", 1.0)):
        ds = kz04(WAVELENGTHS, 20.0, incidence)
        expected = snowoptics.albedo_KZ04(
            WAVELENGTHS * 1e-9, math.radians(30.0), 20.0, diffuse_fraction
        )
        assert ds.reflectance.values == pytest.approx(expected, rel=1e-12)
        assert (ds.transmittance == 0.0).all()
        deep = kz04(WAVELENGTHS, 20.0, incidence, depth_m=50.0)
        assert deep.reflectance.values == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("incidence", [0.0, 60.0, "diffuse"])
def test_finite_layer_without_absorption(incidence):
    ds = kz04(
        WAVELENGTHS, 20.0, incidence, extinction_coefficient=0.0, density_kg_m3=300.0, depth_m=0.1
    )
    thickness = 0.5 * 300.0 * 20.0 * 0.1
    escape = 1.0 if incidence == "diffuse" else 3 / 7 * (1 + 2 * math.cos(math.radians(incidence)))
    expected = escape / (1.072 + 0.75 * thickness * (1.0 - 0.845))
    assert ds.transmittance.values == pytest.approx(expected, rel=1e-6)
    assert (ds.reflectance + ds.transmittance).values == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("incidence", [0.0, 60.0, "diffuse"])
def test_theories_agree_for_weak_absorption(incidence):
    ssa, density, depth, g = 20.0, 300.0, 0.05, 0.7
    k = np.array([3e-9, 1e-7])
    optics = make_layer_optics([1.0, 1.0], 0.25 * ssa * density * depth, g)
    # Diffraction halves 1 − ω = γ/(SSA ρ/4 · 917/ρ), which gives B = 1.
    coalbedo = 4.0 * math.pi * k / (optics.wavelength.values * 1e-9) / (0.25 * ssa * 917.0)
    optics["single_scattering_albedo"] = ("wavelength", 1.0 - coalbedo)
    enhancement, asymmetry = compute_shape_factors(optics, ssa, k)
    assert enhancement == pytest.approx(1.0, rel=1e-6)
    assert asymmetry == pytest.approx(0.85)
    exact = solve_discrete_ordinates(optics, incidence)
    theory = kz04(
        optics.wavelength, ssa, incidence, extinction_coefficient=k,
        absorption_enhancement=enhancement, asymmetry=asymmetry,
        density_kg_m3=density, depth_m=depth,
    )  # fmt: skip
    for name in ("reflectance", "transmittance"):
        assert np.abs(exact[name] - theory[name]).max() < 0.005


def test_dense_packing_reduces_optical_thickness():
    optics = make_layer_optics([0.9], 10.0, 0.5).assign(
        {
            name: ("wavelength", [value])
            for name, value in (
                ("extinction", 1000.0),
                ("displacement_along_incident", 3e-4),
                ("displacement_along_exit", 1e-4),
                ("mean_square_displacement", 8e-8),
            )
        }
    )
    # (1 + 0.3)(1 + 0.1) + (1 − 0.5) 0.08/2, in units of the mean distance squared.
    expected = 10.0 / math.sqrt(1.3 * 1.1 + 0.02)
    assert float(correct_dense_packing(optics).optical_thickness[0]) == pytest.approx(
        expected, rel=1e-12
    )
    assert float(correct_dense_packing(optics).extinction[0]) == pytest.approx(
        100.0 * expected, rel=1e-12
    )
    assert float(optics.optical_thickness[0]) == 10.0


MOMENTS = np.array([[1.0, 0.5, 0.3, 0.2, 0.1]] * 2)


def make_optics(albedo=0.01, moment=0.02):
    """Return optics at two wavelengths, the second of which has interpolation errors."""
    uncertain = np.array([0.0, 1.0])
    return xr.Dataset(
        {
            "single_scattering_albedo": ("wavelength", [0.9, 0.9]),
            "single_scattering_albedo_interpolation_error_bound": (
                "wavelength", albedo * uncertain,
            ),
            "legendre_moment": (("wavelength", "order"), MOMENTS),
            "legendre_moment_interpolation_error_bound": (
                ("wavelength", "order"), np.outer(moment * uncertain, [0.0, 1.0, 1.0, 1.0, 1.0]),
            ),
        },
        {"wavelength": [500.0, 600.0]},
    )  # fmt: skip


def evaluate_backscatter(optics):
    """Return the phase function at backscattering, whose orders alternate in sign."""
    return (optics.legendre_moment * (-1.0) ** np.arange(5)).sum("order").values


def evaluate_product(optics):
    """Return a nonlinear function of two variables and one order."""
    return (optics.single_scattering_albedo * (1.0 + optics.legendre_moment.isel(order=1))).values


@pytest.mark.parametrize("theory", [evaluate_backscatter, evaluate_product])
def test_no_combination_of_errors_exceeds_the_bound(theory):
    exact = make_optics()
    largest = 0.0
    for signs in itertools.product((-1.0, 1.0), repeat=5):
        moments = exact.legendre_moment_interpolation_error_bound * xr.DataArray(
            [0.0, *signs[1:]], dims="order"
        )
        perturbed = exact.assign(
            single_scattering_albedo=exact.single_scattering_albedo
            + signs[0] * exact.single_scattering_albedo_interpolation_error_bound,
            legendre_moment=exact.legendre_moment + moments,
        )
        largest = np.maximum(largest, np.abs(theory(perturbed) - theory(exact)))
    bound = compute_interpolation_bound(theory, exact)
    assert bound[0] == largest[0] == 0.0
    # The product of the deviations, 0.01 · 0.02, adds to about 0.04.
    assert bound[1] == pytest.approx(largest[1], rel=0.02)


def test_without_jackknife_the_error_is_the_bound():
    np.testing.assert_array_equal(
        propagate_errors(evaluate_product, make_optics()),
        compute_interpolation_bound(evaluate_product, make_optics()),
    )
    assert (propagate_errors(evaluate_product, make_optics(0.0, 0.0)) == 0.0).all()


W = np.array([500.0, 1000.0, 1300.0])
AREA, RADIUS, SOOT = (
    "specific_surface_area_m2_kg",
    "optical_radius_um",
    "impurities_ng_g.black_carbon",
)


def make_blank_table(**axes):
    """Return a table of constant reflectance over given axes."""
    return make_table(lambda *point: np.full(W.size, 0.5), axes, w=W)


def test_clean_snow_matches_snowoptics():
    table = make_law_table(make_blank_table(**{AREA: [5.0, 20.0], "incidence_deg": [30.0, 60.0]}))
    assert table.axes == [AREA, "incidence_deg", "wavelength"]
    for i, area in enumerate((5.0, 20.0)):
        for j, beam in enumerate((30.0, 60.0)):
            expected = snowoptics.albedo_direct_KZ04(1e-9 * W, np.radians(beam), area)
            np.testing.assert_allclose(table.dataset.reflectance.values[i, j], expected, rtol=1e-12)


def test_optical_radius_is_equivalent_to_area():
    from_areas = make_law_table(make_blank_table(**{AREA: [10.0, 20.0]})).dataset.reflectance.values
    radii = [3e6 / (917.0 * 20.0), 3e6 / (917.0 * 10.0)]
    from_radii = make_law_table(make_blank_table(**{RADIUS: radii})).dataset.reflectance.values
    np.testing.assert_allclose(from_radii[::-1], from_areas, rtol=1e-12)


def test_impurities_add_the_expected_absorption():
    """Impurities add 2 c M/SSA to 1 − ω, and ln(albedo) is proportional to √(1 − ω)."""
    reflectance = make_law_table(
        make_blank_table(**{AREA: [20.0, 30.0], SOOT: [0.0, 100.0]})
    ).dataset.reflectance.values
    clean, dirty = np.log(reflectance[0])
    absorption = make_impurities({"black_carbon": 100.0}, {})[0].compute_absorption_per_kg_ice(W)
    k = 3.0 / 7.0 * (1.0 + 2.0)
    expected = 16.0 / 3.0 * 2.0 * absorption / 20.0 / (1.0 - snowoptics.default_g)
    np.testing.assert_allclose((dirty / k) ** 2 - (clean / k) ** 2, expected, rtol=1e-9)


def test_axes_outside_the_law_are_dropped_at_zero():
    table = make_blank_table(**{AREA: [5.0, 20.0], "liquid_water_content": [0.0, 0.1]})
    assert make_law_table(table).axes == [AREA, "wavelength"]
    with pytest.raises(InvalidValue, match="liquid_water_content"):
        make_law_table(make_blank_table(**{AREA: [5.0, 20.0], "liquid_water_content": [0.05, 0.1]}))
    with pytest.raises(InvalidValue, match=AREA):
        make_law_table(make_blank_table(saturation=[0.0, 0.5]))
