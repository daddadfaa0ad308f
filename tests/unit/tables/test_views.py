"""Directions of observation of tables: interpolation, fields of view, isotropic light, messages."""

import numpy as np
import pytest
from direction_tables import (
    SIZE,
    evaluate_amplitude,
    evaluate_factor,
    evaluate_reflectance,
    make_direction_dataset,
)

import splits
from splits.core.validation import InvalidValue

WAVELENGTH = np.array([500.0, 900.0])
AT = {SIZE: 100.0, "incidence_deg": 40.0}
VIEWS = {"polar_deg": [0.0, 30.0], "azimuth_deg": [0.0, 180.0]}


@pytest.fixture
def table():
    return splits.Table(make_direction_dataset())


@pytest.mark.parametrize(("polar", "azimuth"), [(33.0, 100.0), (33.0, 260.0), (7.0, 260.0)])
def test_directions_between_nodes_have_the_analytic_values(table, polar, azimuth):
    found = table.at_view(polar, azimuth).interp(**AT)
    factor = evaluate_factor(100.0, 40.0, polar, azimuth, WAVELENGTH)
    reflectance = evaluate_reflectance(100.0, 40.0, WAVELENGTH)
    np.testing.assert_allclose(found.reflectance_factor, factor, rtol=3e-4)
    np.testing.assert_allclose(found.anisotropy_factor, factor / reflectance, rtol=3e-4)
    np.testing.assert_allclose(found.reflectance, reflectance, rtol=1e-6)


def test_positions_may_include_the_direction(table):
    direct = table.interp(**AT, polar_deg=33.0, azimuth_deg=100.0)
    fixed = table.at_view(33.0, 100.0).interp(**AT)
    for name in table.point_quantities:
        np.testing.assert_allclose(direct[name], fixed[name], rtol=1e-6)
        # Errors of directions may add to those of the other axes, or are part of the nodes'.
        ratio = direct[f"{name}_stderr"] / fixed[f"{name}_stderr"]
        assert ((ratio > 0.7) & (ratio < 2.0)).all()
    slope = table.derivatives([SIZE], **AT, polar_deg=30.0, azimuth_deg=90.0)
    # Between two sizes, values are linear in the logarithm.
    low, high = (evaluate_factor(size, 40.0, 30.0, 90.0, WAVELENGTH) for size in (100.0, 400.0))
    expected = (high - low) / np.log(4.0) / 100.0
    np.testing.assert_allclose(slope.reflectance_factor_jacobian.values[0], expected, rtol=1e-5)


def test_field_of_view_averages_over_a_cone(table):
    random = np.random.default_rng(3)
    cosine = 1.0 - random.random(200_000) * (1.0 - np.cos(np.radians(15.0)))
    turn = random.random(200_000) * 2.0 * np.pi
    sine, tilt = np.sqrt(1.0 - cosine**2), np.radians(30.0)
    x, y = sine * np.cos(turn), sine * np.sin(turn)
    x, z = x * np.cos(tilt) + cosine * np.sin(tilt), cosine * np.cos(tilt) - x * np.sin(tilt)
    polar, azimuth = np.degrees(np.arccos(z)), 60.0 + np.degrees(np.arctan2(y, x))
    factor = evaluate_factor(100.0, 40.0, polar, azimuth, 500.0)
    expected = (factor * z).sum() / z.sum()
    found = table.at_view(30.0, 60.0, field_of_view_deg=30.0).interp(**AT, wavelength=[500.0])
    np.testing.assert_allclose(found.reflectance_factor, expected, rtol=1e-3)
    narrow = table.at_view(30.0, 60.0, field_of_view_deg=0.1).interp(**AT)
    exact = table.at_view(30.0, 60.0).interp(**AT)
    np.testing.assert_allclose(narrow.reflectance_factor, exact.reflectance_factor, rtol=1e-4)


def test_isotropic_light_is_mixed_by_its_fraction(table):
    fraction = np.array([0.4, 0.1])
    found = table.at_view(30.0, 180.0, diffuse_fraction=fraction).interp(**AT)
    beam = evaluate_factor(100.0, 40.0, 30.0, 180.0, WAVELENGTH)
    sky = evaluate_reflectance(100.0, 30.0, WAVELENGTH)
    factor = (1.0 - fraction) * beam + fraction * sky
    bihemispherical = evaluate_amplitude(100.0, WAVELENGTH) * (1.0 - 0.8 / 9.0)
    direct = evaluate_reflectance(100.0, 40.0, WAVELENGTH)
    albedo = (1.0 - fraction) * direct + fraction * bihemispherical
    np.testing.assert_allclose(found.reflectance_factor, factor, rtol=1e-5)
    np.testing.assert_allclose(found.reflectance, albedo, rtol=1e-6)
    np.testing.assert_allclose(found.anisotropy_factor, factor / albedo, rtol=1e-5)
    assert (found.anisotropy_factor_stderr > 0.0).all()


def test_sizes_are_retrieved_from_one_direction(table):
    fixed = {"incidence_deg": 50.0, "polar_deg": 20.0, "azimuth_deg": 120.0}
    measured = evaluate_factor(230.0, 50.0, 20.0, 120.0, WAVELENGTH)
    found = splits.retrieve(
        (WAVELENGTH, measured), table, [SIZE], 0.001, fixed=fixed, quantity="reflectance_factor"
    )
    assert abs(found.values[SIZE] - 230.0) < 3.0 * found.stderr[SIZE]
    assert {found.dataset.attrs[f"fixed_{name}"] for name in fixed} == set(fixed.values())
    by_view = splits.retrieve(
        (WAVELENGTH, measured), table.at_view(20.0, 120.0), [SIZE], 0.001,
        fixed={"incidence_deg": 50.0}, quantity="reflectance_factor",
    )  # fmt: skip
    assert by_view.values == found.values


def test_axes_of_one_angle_may_be_omitted(table):
    single = splits.Table(table.dataset.sel(polar_deg=[30.0], azimuth_deg=[90.0]))
    expected = table.interp(**AT, polar_deg=30.0, azimuth_deg=90.0)
    np.testing.assert_allclose(single.interp(**AT).reflectance_factor, expected.reflectance_factor)


def test_azimuths_without_effect_may_be_omitted(table):
    assert table.at_view(0.0).dataset.equals(table.at_view(0.0, 120.0).dataset)
    single = splits.Table(table.dataset.sel(azimuth_deg=[90.0]))
    found = single.at_view(30.0).dataset.reflectance_factor
    np.testing.assert_allclose(found, table.at_view(30.0, 90.0).dataset.reflectance_factor)
    normal = splits.Table(table.dataset.sel(incidence_deg=[0.0], azimuth_deg=[0.0]))
    assert normal.at_view(30.0, 90.0).axes == [SIZE, "incidence_deg", "wavelength"]
    with pytest.raises(InvalidValue, match="azimuth_deg = None: must be given"):
        table.at_view(30.0)


def test_tables_of_some_quantities(table):
    names = ["reflectance", "diffuse_reflectance", "diffuse_reflectance_factor"]
    part = table.dataset[[f"{name}{end}" for name in names for end in ("", "_stderr")]]
    some = splits.Table(part)
    assert some.axes == [SIZE, "incidence_deg", "polar_deg", "wavelength"]
    mixed = some.at_view(20.0, diffuse_fraction=0.3)
    assert mixed.quantities == ["reflectance"]
    with pytest.raises(InvalidValue, match="under isotropic light alone"):
        splits.Table(part.drop_vars(["reflectance", "reflectance_stderr"])).at_view(20.0)
    factors = splits.Table(table.dataset.drop_vars(["reflectance", "reflectance_stderr"]))
    with pytest.raises(InvalidValue, match="the table lacks reflectance"):
        factors.at_view(20.0, 90.0, diffuse_fraction=0.3)


def test_media_without_light_have_no_anisotropy(table):
    dark = splits.Table(0.0 * table.dataset.assign_attrs()).dataset.assign_attrs(
        table.dataset.attrs
    )
    found = splits.Table(dark).at_view(30.0, 90.0, diffuse_fraction=0.5).interp(**AT)
    assert (found.anisotropy_factor == 0.0).all() and (found.reflectance == 0.0).all()


AT_VIEW_MISTAKES = {
    "polar_deg = 95.0: must be in [0, 90)": {"polar_deg": 95.0},
    "polar_deg = 80.0: must be from 0 to 75, as far as the table goes": {"polar_deg": 80.0},
    "azimuth_deg = 400": {"polar_deg": 30.0, "azimuth_deg": 400.0},
    "field_of_view_deg = 70": {"polar_deg": 30.0, "field_of_view_deg": 70.0},
    "field_of_view_deg = 20.0: must be within the polar_deg of the table, 0 to 75 "
    "(around polar_deg = 70, azimuth_deg = 0)": {"polar_deg": 70.0, "field_of_view_deg": 20.0},
    "polar_deg = 80.0: must be from 0 to 75": {"polar_deg": 80.0, "field_of_view_deg": 5.0},
    "diffuse_fraction": {"polar_deg": 30.0, "diffuse_fraction": 1.2},
    "diffuse_fraction = 'of shape (3,)'": {"polar_deg": 30.0, "diffuse_fraction": [0.1] * 3},
    "polar_deg = nan": {"polar_deg": np.nan},
}


@pytest.mark.parametrize("message", AT_VIEW_MISTAKES)
def test_invalid_directions_are_rejected(table, message):
    with pytest.raises(InvalidValue) as error:
        table.at_view(**{"azimuth_deg": 0.0, **AT_VIEW_MISTAKES[message]})
    print(error.value)
    assert message in str(error.value)


def test_tables_without_the_quantities_are_rejected(table):
    without = splits.Table(table.dataset.drop_vars("diffuse_reflectance"))
    with pytest.raises(InvalidValue, match="the table lacks diffuse_reflectance"):
        without.at_view(30.0, 0.0, diffuse_fraction=0.5)
    with pytest.raises(InvalidValue, match="left out for a table without directions"):
        table.at_view(30.0, 0.0).at_view(30.0)
    with pytest.raises(InvalidValue, match="azimuth_deg"):
        table.interp(**AT, polar_deg=30.0)
    arguments = (WAVELENGTH, [0.5, 0.4]), table
    with pytest.raises(InvalidValue, match=r"fixed\.polar_deg"):
        splits.retrieve(*arguments, [SIZE], 0.01, fixed=AT, quantity="reflectance_factor")
    with pytest.raises(InvalidValue, match="not retrieved"):
        splits.retrieve(*arguments, [SIZE, "polar_deg"], 0.01, quantity="reflectance_factor")
    with pytest.raises(InvalidValue, match="quantity = None: must be given: reflectance or"):
        splits.retrieve(*arguments, [SIZE], 0.01, fixed=AT | {"polar_deg": 0.0})


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("vza", "did you mean polar_deg?"),
        ("raa", "did you mean azimuth_deg? azimuth_deg is 180 minus a relative azimuth that is 0"),
        ("sza", "incidence_deg is an argument of instruments, and of tables with this axis"),
    ],
)
def test_angles_under_other_names_have_a_hint(table, name, hint):
    with pytest.raises(TypeError) as error:
        table.at_view(**{name: 30.0})
    assert f"{name}: unknown key" in str(error.value) and hint in str(error.value)
    if name != "sza":
        with pytest.raises(InvalidValue) as error:
            table.interp(**AT, **{name: 30.0})
        assert f"{name}: unknown key" in str(error.value) and hint in str(error.value)


def test_the_text_of_a_table_names_its_direction(table):
    view = table.at_view(25.0, 140.0, field_of_view_deg=10.0, diffuse_fraction=[0.2, 0.1])
    assert repr(view).splitlines()[-1] == (
        "  direction: polar_deg 25, azimuth_deg 140, field_of_view_deg 10, "
        "diffuse_fraction 0.1 to 0.2"
    )
    assert "direction:" not in repr(table)


BUILD_MISTAKES = {
    "grid.azimuth_deg = None: must be given (polar_deg needs it)": {"grid": {"polar_deg": [0.0]}},
    "grid.polar_deg": {"grid": VIEWS | {"polar_deg": [10.0, 95.0]}},
    "grid.azimuth_deg = 270.0: must be in [0, 180] degrees (both sides of the plane of incidence": {
        "grid": VIEWS | {"azimuth_deg": [0.0, 270.0]}
    },
    "it needs polar_deg and azimuth_deg": {"quantities": ["reflectance_factor"]},
    "leave out polar_deg and azimuth_deg": {"grid": VIEWS, "quantities": ["transmittance"]},
    "quantities = 'brdf'": {"grid": VIEWS, "quantities": ["brdf"]},
    "grid.vza = 30.0: must be a parameter of the medium, or an angle (did you mean polar_deg?)": {
        "grid": {"vza": [30.0]}
    },
    "grid.sza = 0.0: must be a parameter of the medium, or an angle (did you mean incid": {
        "grid": {"sza": [0.0, 30.0]}
    },
    "grid.incidence_deg = 35.0: must be a list of different values, numbers or text (write [35.0], "
    "or give the argument incidence_deg=35.0 and leave it out of the grid)": {
        "grid": {"incidence_deg": 35.0}
    },
    "grid.depth_m = 1: must be a list of different values, numbers or text (write [1])": {
        "grid": {"depth_m": 1}
    },
    "incidence_deg = [35]: must be one angle in degrees, or diffuse "
    "(the grid takes the axis 'incidence_deg': [35])": {"incidence_deg": [35]},
    "incidence_deg = 35.0: must be left out, because grid.incidence_deg sets it": {
        "incidence_deg": np.array(35), "grid": {"incidence_deg": [35]}
    },
    "covariance = True": {"grid": VIEWS, "covariance": True},
    "angles with quantities under isotropic light": {
        "grid": VIEWS, "quantities": ["diffuse_reflectance"], "incidence_deg": "diffuse",
    },
}  # fmt: skip


@pytest.mark.parametrize("message", BUILD_MISTAKES)
def test_invalid_tables_are_rejected(message):
    arguments = dict(BUILD_MISTAKES[message])
    grid = {"optical_radius_um": [100.0]} | arguments.pop("grid", {})
    with pytest.raises(InvalidValue) as error:
        splits.build_table(splits.Snow.natural, grid, [600.0], **arguments)
    print(error.value)
    assert message in str(error.value)
