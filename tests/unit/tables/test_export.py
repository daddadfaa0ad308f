"""Export of tables: formats compared to their definition, and to the programs if installed."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from splits.core.validation import InvalidValue
from splits.illumination.bands import SpectralBand
from splits.tables.export import compute_response_weights
from splits.tables.table import Table

AXES = {
    "optical_radius_um": np.array([50.0, 100.0, 200.0, 400.0]),
    "incidence_deg": np.array([0.0, 30.0, 60.0]),
    "impurities_ng_g.dust": np.array([0.0, 1000.0, 5000.0]),
    "liquid_water_content": np.array([0.0, 0.05]),
    "wavelength": np.arange(400.0, 1001.0, 10.0),
}
GREEN, RED = (520.0, 600.0), (630.0, 690.0)


@pytest.fixture
def table():
    size, angle, dust, water, w = np.meshgrid(*AXES.values(), indexing="ij", sparse=True)
    values = np.exp(-np.sqrt(size / 1e4) * (w / 600.0) * np.cos(np.radians(angle)))
    values = values / (1.0 + 1e-4 * dust) - 0.1 * water
    found = {
        "reflectance": (tuple(AXES), values.astype(np.float32), {"long_name": "reflectance"}),
        "reflectance_stderr": (tuple(AXES), np.full(values.shape, 1e-3, np.float32)),
    }
    return Table(xr.Dataset(found, AXES, {"path_sharing_axes": "none"}))


def test_a_csv_file_has_a_line_for_every_value(table, tmp_path):
    table.to_csv(tmp_path / "table.csv")
    found = pd.read_csv(tmp_path / "table.csv")
    assert list(found.columns) == [*AXES, "reflectance", "reflectance_stderr"]
    assert len(found) == table.dataset.reflectance.size
    back = found.set_index(list(AXES)).to_xarray()
    np.testing.assert_allclose(back.reflectance, table.dataset.reflectance, rtol=1e-5)


def test_spires_looks_up_what_the_table_holds(table):
    made = table.to_spires(
        "impurities_ng_g.dust", {"green": GREEN, "red": RED}, liquid_water_content=0.05
    )
    assert made.dims == ("band", "solar_angle", "dust_concentration", "grain_size")
    assert made.band.values.tolist() == [1, 2]
    assert made.dust_concentration.values.tolist() == [0.0, 1.0, 5.0]
    at = {"impurities_ng_g.dust": 1000.0, "liquid_water_content": 0.05, "incidence_deg": 30.0,
          "optical_radius_um": 200.0}  # fmt: skip
    one = table.dataset.reflectance.sel(at)
    inside = one.sel(wavelength=slice(*RED)).values.astype(float)
    mean = np.trapezoid(inside, dx=10.0) / 60.0
    found = made.sel(band=2, solar_angle=30.0, dust_concentration=1.0, grain_size=200.0)
    assert float(found) == pytest.approx(mean, abs=1e-6)


def test_spires_itself_interpolates_it(table):
    spires = pytest.importorskip("spires")
    made = table.to_spires(
        "impurities_ng_g.dust", {"green": GREEN, "red": RED}, liquid_water_content=0.0
    )
    opened = spires.LutInterpolator(
        reflectances=made.values, bands=made.band.values, solar_angles=made.solar_angle.values,
        dust_concentrations=made.dust_concentration.values, grain_sizes=made.grain_size.values,
    )  # fmt: skip
    at = made.sel(band=2, solar_angle=30.0, dust_concentration=1.0)
    for size in (100.0, 150.0):
        expected = float(at.interp(grain_size=size))
        found = opened.interpolate(
            band=2, solar_angle=30.0, dust_concentration=1.0, grain_size=size
        )
        assert found == pytest.approx(expected, abs=1e-9)


def test_isofit_finds_the_names_that_it_looks_for(table):
    made = table.to_isofit(**{"impurities_ng_g.dust": 0.0, "liquid_water_content": 0.0})
    assert made.rho_dif_dir.dims == (
        "solar_zenith", "observer_zenith", "relative_azimuth", "grain_radius", "wl",
    )  # fmt: skip
    assert made["statevec_names"].values.tolist() == ["GRAIN_RADIUS"]
    at = {"impurities_ng_g.dust": 0.0, "liquid_water_content": 0.0, "incidence_deg": 60.0}
    expected = table.dataset.reflectance.sel(at)
    for sun in AXES["incidence_deg"]:
        found = made.rho_dif_dir.sel(solar_zenith=sun, observer_zenith=60.0, relative_azimuth=180.0)
        np.testing.assert_array_equal(found.values, expected.values)


def directions(**changes):
    """Return bidirectional reflectance factors that differ along every axis."""
    axes = {
        "optical_radius_um": np.array([100.0, 400.0]), "incidence_deg": np.array([0.0, 50.0]),
        "wavelength": np.array([500.0, 900.0]), "polar": np.array([0.0, 20.0, 60.0]),
        "azimuth": np.array([0.0, 90.0, 180.0, 270.0]),
    } | changes  # fmt: skip
    size, sun, w, polar, azimuth = np.meshgrid(*axes.values(), indexing="ij")
    turned = np.minimum(azimuth, 360.0 - azimuth)
    values = 1e-4 * size + 1e-3 * sun + 1e-5 * w + 1e-2 * polar + 1e-6 * turned
    return xr.Dataset({"reflectance_factor": (tuple(axes), values)}, axes)


def test_isofit_finds_both_reflectances_by_direction(table):
    clean = {"impurities_ng_g.dust": 0.0, "liquid_water_content": 0.0}
    given = directions()
    made = table.to_isofit(given, **clean)
    assert made.rho_dir_dir.dims == made.rho_dif_dir.dims
    assert made.relative_azimuth.values.tolist() == [0.0, 90.0, 180.0]
    for azimuth in (0.0, 90.0, 180.0):
        at = {"optical_radius_um": 400.0, "incidence_deg": 50.0, "wavelength": 900.0, "polar": 20.0}
        expected = float(given.reflectance_factor.sel({**at, "azimuth": azimuth}))
        # 0 is the sun's side there, and forward here.
        found = made.sel(grain_radius=400.0, solar_zenith=50.0, wl=900.0, observer_zenith=20.0,
                         relative_azimuth=180.0 - azimuth)  # fmt: skip
        assert float(found.rho_dir_dir) == expected
    read = table.interp(**clean, optical_radius_um=400.0, incidence_deg=20.0, wavelength=900.0)
    assert float(found.rho_dif_dir) == pytest.approx(float(read.reflectance[0]), abs=1e-7)


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"optical_radius_um": np.array([100.0, 300.0])}, "directions.optical_radius_um = "),
        ({"wavelength": np.array([555.5, 900.0])}, "directions.wavelength = "),
        ({"polar": np.array([0.0, 20.0, 75.0])}, "incidence_deg = 75.0: must be from 0 to 60"),
    ],
)
def test_directions_outside_the_table_are_rejected(table, changes, line):
    clean = {"impurities_ng_g.dust": 0.0, "liquid_water_content": 0.0}
    with pytest.raises(InvalidValue, match=f"^{line}"):
        table.to_isofit(directions(**changes), **clean)


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda t: t.to_isofit(), "impurities_ng_g.dust = None: must be given"),
        (
            lambda t: t.to_isofit(**{"impurities_ng_g.dust": 7.0, "liquid_water_content": 0.0}),
            "impurities_ng_g.dust = 7.0: must be one of",
        ),
        (lambda t: t.to_isofit(t.dataset, **{"impurities_ng_g.dust": 0.0,
                                             "liquid_water_content": 0.0}), "directions = "),
        (lambda t: t.to_spires("soot", {"red": RED}), "axis = 'soot': must be one of"),
        (
            lambda t: t.to_spires(
                "impurities_ng_g.dust", {"far": (900, 1100)}, liquid_water_content=0.0
            ),
            r"bands\['far'\] = .*within the table",
        ),
    ],
)  # fmt: skip
def test_what_a_format_cannot_hold_is_rejected(table, call, line):
    with pytest.raises(InvalidValue, match=f"^{line}"):
        call(table)


def test_bands_are_means_by_their_response():
    """Of a spectrum that is linear between the wavelengths of the table, whatever these are."""
    w = np.array([500.0, 700.0, 900.0, 1100.0])
    spectrum = np.array([0.95, 0.85, 0.6, 0.2])
    fine = np.linspace(400.0, 1200.0, 80_001)
    for band in (
        SpectralBand.from_limits(700.0, 1100.0), SpectralBand.from_limits(620.0, 670.0),
        SpectralBand(np.array([550.0, 700.0, 950.0]), np.array([0.0, 1.0, 0.2])),
    ):  # fmt: skip
        low, high = band.limits_nm
        inside = fine[(fine >= low) & (fine <= high)]
        response = np.interp(inside, band.wavelength_nm, band.response)
        mean = np.trapezoid(np.interp(inside, w, spectrum) * response, inside)
        mean /= np.trapezoid(response, inside)
        assert compute_response_weights("a", band, w) @ spectrum == pytest.approx(mean, abs=1e-7)


def test_the_node_that_is_asked_for_is_held(table):
    small = table.dataset.assign_coords(liquid_water_content=[0.0, 1e-9])
    held = {"impurities_ng_g.dust": 0.0, "liquid_water_content": 1e-9}
    found = Table(small).to_isofit(**held).rho_dif_dir
    expected = small.reflectance.isel({"liquid_water_content": 1, "impurities_ng_g.dust": 0})
    assert found.values[0, 0, 0, 0, 0] == expected.values[0, 0, 0]
