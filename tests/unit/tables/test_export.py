"""Export of tables: formats compared with their definition, and with installed programs."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from splits.core.validation import InvalidValue
from splits.illumination.bands import SpectralBand, compute_response_weights
from splits.tables.table import Table

AXES = {
    "optical_radius_um": np.array([50.0, 100.0, 200.0, 400.0]),
    "incidence_deg": np.array([0.0, 30.0, 60.0]),
    "impurities_ng_g.dust": np.array([0.0, 1000.0, 5000.0]),
    "liquid_water_content": np.array([0.0, 0.05]),
    "wavelength": np.arange(400.0, 1001.0, 10.0),
}


@pytest.fixture
def table():
    size, angle, dust, water, w = np.meshgrid(*AXES.values(), indexing="ij", sparse=True)
    values = np.exp(-np.sqrt(size / 1e4) * (w / 600.0) * np.cos(np.radians(angle)))
    values = values / (1.0 + 1e-4 * dust) - 0.1 * water
    variables = {
        "reflectance": (tuple(AXES), values.astype(np.float32), {"long_name": "reflectance"}),
        "reflectance_stderr": (tuple(AXES), np.full(values.shape, 1e-3, np.float32)),
    }
    return Table(xr.Dataset(variables, AXES, {"path_sharing_axes": "none"}))


def test_csv_files_have_a_line_for_every_value(table, tmp_path):
    table.to_csv(tmp_path / "table.csv")
    frame = pd.read_csv(tmp_path / "table.csv")
    assert list(frame.columns) == [*AXES, "reflectance", "reflectance_stderr"]
    assert len(frame) == table.dataset.reflectance.size
    restored = frame.set_index(list(AXES)).to_xarray()
    np.testing.assert_allclose(restored.reflectance, table.dataset.reflectance, rtol=1e-5)


def test_isofit_export_has_the_required_names(table):
    exported = table.to_isofit(**{"impurities_ng_g.dust": 0.0, "liquid_water_content": 0.0})
    assert exported.rho_dif_dir.dims == (
        "solar_zenith", "observer_zenith", "relative_azimuth", "grain_radius", "wl",
    )  # fmt: skip
    assert exported["statevec_names"].values.tolist() == ["grain_radius"]
    point = {"impurities_ng_g.dust": 0.0, "liquid_water_content": 0.0, "incidence_deg": 60.0}
    expected = table.dataset.reflectance.sel(point)
    for sun in AXES["incidence_deg"]:
        actual = exported.rho_dif_dir.sel(
            solar_zenith=sun, observer_zenith=60.0, relative_azimuth=180.0
        )
        np.testing.assert_array_equal(actual.values, expected.values)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda t: t.to_isofit(), "impurities_ng_g.dust = None: must be given"),
        (
            lambda t: t.to_isofit(**{"impurities_ng_g.dust": 7.0, "liquid_water_content": 0.0}),
            "impurities_ng_g.dust = 7.0: must be one of",
        ),
    ],
)  # fmt: skip
def test_unsupported_exports_are_rejected(table, call, message):
    with pytest.raises(InvalidValue, match=f"^{message}"):
        call(table)


def test_band_weights_are_means_over_the_response():
    """The weights are exact for spectra that are linear between the wavelengths of the table."""
    w = np.array([500.0, 700.0, 900.0, 1100.0])
    spectrum = np.array([0.95, 0.85, 0.6, 0.2])
    fine = np.linspace(400.0, 1200.0, 80_001)
    for band in (
        SpectralBand.from_limits(700.0, 1100.0), SpectralBand.from_limits(620.0, 670.0),
        SpectralBand(np.array([550.0, 700.0, 950.0]), np.array([0.0, 1.0, 0.2])),
    ):  # fmt: skip
        low, high = band.limits_nm
        in_band = fine[(fine >= low) & (fine <= high)]
        response = np.interp(in_band, band.wavelength_nm, band.response)
        mean = np.trapezoid(np.interp(in_band, w, spectrum) * response, in_band)
        mean /= np.trapezoid(response, in_band)
        assert compute_response_weights("a", band, w) @ spectrum == pytest.approx(mean, abs=1e-7)


def test_the_requested_node_is_exported(table):
    dataset = table.dataset.assign_coords(liquid_water_content=[0.0, 1e-9])
    fixed = {"impurities_ng_g.dust": 0.0, "liquid_water_content": 1e-9}
    exported = Table(dataset).to_isofit(**fixed).rho_dif_dir
    expected = dataset.reflectance.isel({"liquid_water_content": 1, "impurities_ng_g.dust": 0})
    assert exported.values[0, 0, 0, 0, 0] == expected.values[0, 0, 0]
