"""Tables in the formats of other programs."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from direction_tables import (
    AXES,
    DIMS,
    SIZE,
    evaluate_factor,
    evaluate_reflectance,
    make_direction_dataset,
)

from splits.core.validation import InvalidValue
from splits.illumination.bands import SpectralBand, compute_response_weights
from splits.tables.conversions import (
    ISOFIT_DIMS,
    convert_to_eradiate,
    convert_to_isofit,
    write_csv,
)
from splits.tables.table import Table

NODES = {
    "optical_radius_um": np.array([50.0, 100.0, 200.0, 400.0]),
    "incidence_deg": np.array([0.0, 30.0, 60.0]),
    "impurities_ng_g.dust": np.array([0.0, 1000.0, 5000.0]),
    "liquid_water_content": np.array([0.0, 0.05]),
    "wavelength": np.arange(400.0, 1001.0, 10.0),
}


@pytest.fixture
def table():
    size, angle, dust, water, w = np.meshgrid(*NODES.values(), indexing="ij", sparse=True)
    values = np.exp(-np.sqrt(size / 1e4) * (w / 600.0) * np.cos(np.radians(angle)))
    values = values / (1.0 + 1e-4 * dust) - 0.1 * water
    variables = {
        "reflectance": (tuple(NODES), values.astype(np.float32), {"long_name": "reflectance"}),
        "reflectance_stderr": (tuple(NODES), np.full(values.shape, 1e-3, np.float32)),
    }
    return Table(xr.Dataset(variables, NODES, {"path_sharing_axes": "none"}))


def test_csv_files_have_a_line_for_every_value(table, tmp_path):
    table.to_csv(tmp_path / "table.csv")
    frame = pd.read_csv(tmp_path / "table.csv")
    assert list(frame.columns) == [*NODES, "reflectance", "reflectance_stderr"]
    assert len(frame) == table.dataset.reflectance.size
    restored = frame.set_index(list(NODES)).to_xarray()
    np.testing.assert_allclose(restored.reflectance, table.dataset.reflectance, rtol=1e-5)


def test_isofit_export_has_the_required_names(table):
    exported = table.to_isofit(**{"impurities_ng_g.dust": 0.0, "liquid_water_content": 0.0})
    assert exported.rho_dif_dir.dims == (
        "solar_zenith", "observer_zenith", "relative_azimuth", "grain_radius", "wl",
    )  # fmt: skip
    assert exported["statevec_names"].values.tolist() == ["grain_radius"]
    point = {"impurities_ng_g.dust": 0.0, "liquid_water_content": 0.0, "incidence_deg": 60.0}
    expected = table.dataset.reflectance.sel(point)
    for sun in NODES["incidence_deg"]:
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


# --- tables with directions -----------------------------------------------------------------------


COARSE = {SIZE: 100.0}
AT_500_NM = {"wavelength": 500.0, **COARSE}


@pytest.fixture
def dataset():
    return make_direction_dataset()


def reopen(converted, folder):
    converted.to_netcdf(folder / "converted.nc")
    with xr.open_dataset(folder / "converted.nc") as opened:
        return opened.load()


def test_isofit_files_have_the_order_and_types_of_the_format(dataset, tmp_path):
    opened = reopen(convert_to_isofit(dataset), tmp_path)
    # The program takes the order of the axes from the order of the coordinates in the file.
    assert tuple(opened.coords) == ISOFIT_DIMS
    assert opened.rho_dir_dir.dims == opened.rho_dif_dir.dims == ISOFIT_DIMS
    assert opened.rho_dir_dir.dtype == opened.rho_dif_dir.dtype == np.float32
    assert set(opened.statevec_names.values.tolist()) == {"grain_radius"} <= set(ISOFIT_DIMS)
    assert all((np.diff(opened[name]) > 0.0).all() for name in ISOFIT_DIMS)
    assert opened.relative_azimuth.values[[0, -1]].tolist() == [0.0, 180.0]


@pytest.mark.parametrize("has_diffuse_factor", [True, False])
def test_isofit_tables_have_the_analytic_reflectances(dataset, has_diffuse_factor):
    if not has_diffuse_factor:
        dataset = dataset.drop_vars("diffuse_reflectance_factor")
    converted = convert_to_isofit(dataset)
    sun, view, relative_azimuth, size, w = xr.broadcast(*(converted[d] for d in ISOFIT_DIMS))
    expected = evaluate_factor(size, sun, view, 180.0 - relative_azimuth, w)
    np.testing.assert_allclose(converted.rho_dir_dir, expected, rtol=1e-6)
    expected = evaluate_reflectance(size, view, w)
    np.testing.assert_allclose(converted.rho_dif_dir, expected, rtol=1e-6)


def test_isofit_has_forward_scattering_away_from_the_sun(dataset):
    point = {"solar_zenith": 60.0, "observer_zenith": 60.0}
    converted = convert_to_isofit(dataset).sel(point).rho_dir_dir
    assert (converted.argmax("relative_azimuth") == converted.sizes["relative_azimuth"] - 1).all()


def test_isofit_tables_are_independent_of_axis_order(dataset):
    shuffled = dataset.sortby([*AXES], ascending=False).transpose("wavelength", ...)
    converted = convert_to_isofit(shuffled).sortby("wl")
    xr.testing.assert_equal(converted, convert_to_isofit(dataset))


def test_eradiate_files_have_the_format(dataset, tmp_path):
    opened = reopen(
        convert_to_eradiate(dataset, wavelength=500.0, n_cosines=11, n_azimuths=24, **COARSE),
        tmp_path,
    )
    assert opened.brdf.dims == ("cos_theta_o", "phi_d", "cos_theta_i")
    assert opened.brdf.dtype == np.float32
    for name in ("cos_theta_o", "cos_theta_i"):
        np.testing.assert_allclose(opened[name], np.linspace(0.0, 1.0, 11))
    np.testing.assert_allclose(opened.phi_d, np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False))
    assert opened.phi_d.attrs["units"] == "rad"
    assert opened.attrs["last_zenith_deg"].tolist() == [75.0, 75.0]
    assert opened.attrs["wavelength_nm"] == 500.0


def test_eradiate_brdf_is_the_analytic_one(dataset):
    converted = convert_to_eradiate(
        dataset, wavelength=900.0, n_cosines=11, n_azimuths=24, **COARSE
    )
    cosine_o, phi, cosine_i = xr.broadcast(*(converted[d] for d in converted.brdf.dims))
    last = np.cos(np.radians(75.0))
    polar, incidence = (np.degrees(np.arccos(np.maximum(c, last))) for c in (cosine_o, cosine_i))
    azimuth = 180.0 - np.degrees(phi)
    expected = evaluate_factor(100.0, incidence, polar, azimuth, 900.0) / np.pi
    np.testing.assert_allclose(converted.brdf, expected, atol=3e-4)
    forward = converted.brdf.sel(phi_d=np.pi, method="nearest")
    assert (forward >= converted.brdf.max("phi_d") - 1e-6).all()
    mirrored = converted.brdf.isel(phi_d=slice(None, 0, -1))
    np.testing.assert_allclose(converted.brdf.isel(phi_d=slice(1, None)), mirrored, atol=1e-6)


def test_eradiate_brdf_distinguishes_sun_and_view(dataset):
    dataset["reflectance_factor"] = dataset.reflectance_factor * (1.0 + 0.01 * dataset.polar_deg)
    converted = convert_to_eradiate(dataset, wavelength=500.0, n_cosines=3, n_azimuths=2, **COARSE)
    view_from_above = converted.brdf.sel(cos_theta_o=1.0, cos_theta_i=0.5, phi_d=0.0)
    expected = evaluate_factor(100.0, 60.0, 0.0, 180.0, 500.0) / np.pi
    assert float(view_from_above) == pytest.approx(expected, rel=1e-5)


def test_eradiate_wavelength_may_be_omitted_if_there_is_one(dataset):
    expected = convert_to_eradiate(dataset, wavelength=500.0, n_cosines=3, n_azimuths=2, **COARSE)
    single = dataset.isel(wavelength=[0])
    xr.testing.assert_identical(
        convert_to_eradiate(single, n_cosines=3, n_azimuths=2, **COARSE), expected
    )


def test_negative_interpolated_values_become_zero(dataset):
    polar = dataset.polar_deg.values
    steep = np.where(polar == 75.0, 1.0, 0.0).astype(np.float32)
    dataset["reflectance_factor"] = dataset.reflectance_factor * xr.DataArray(
        steep, dims="polar_deg"
    )
    assert (
        convert_to_eradiate(
            dataset, wavelength=500.0, n_cosines=31, n_azimuths=2, **COARSE
        ).brdf.min()
        == 0.0
    )


def test_eradiate_evaluates_the_converted_brdf(dataset):
    eradiate = pytest.importorskip("eradiate")
    mitsuba = pytest.importorskip("mitsuba")
    eradiate.set_mode("mono_double")
    from eradiate.scenes.bsdfs import MQDiffuseBSDF

    converted = convert_to_eradiate(
        dataset, wavelength=500.0, n_cosines=21, n_azimuths=36, **COARSE
    )
    grid = MQDiffuseBSDF(data=converted)._eval_grid_impl(None)
    bsdf = mitsuba.load_dict({"type": "mqdiffuse", "grid": grid})
    sun = mitsuba.SurfaceInteraction3f()
    sun.wi = [-np.sin(np.radians(60.0)), 0.0, 0.5]
    for azimuth in (0.0, 90.0, 180.0):
        x, y = np.sin(np.radians(60.0)) * np.array(
            [np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))]
        )
        value = bsdf.eval(mitsuba.BSDFContext(), sun, mitsuba.Vector3f(x, y, 0.5))
        expected = 0.5 * evaluate_factor(100.0, 60.0, 60.0, azimuth, 500.0) / np.pi
        assert float(np.ravel(np.array(value))[0]) == pytest.approx(expected, abs=1e-5)


def test_csv_files_repeat_hemispherical_quantities(dataset, tmp_path):
    write_csv(dataset, tmp_path / "table.csv")
    frame = pd.read_csv(tmp_path / "table.csv")
    assert list(frame.columns) == [*AXES, *dataset.data_vars]
    assert len(frame) == dataset.reflectance_factor.size
    restored = frame.set_index([*AXES]).to_xarray()
    for name, dims in DIMS.items():
        for variable in (name, f"{name}_stderr"):
            other_axes = {axis: 0 for axis in AXES if axis not in dims}
            assert (restored[variable] == restored[variable].isel(other_axes)).all()
            actual = restored[variable].isel(other_axes).transpose(*dims)
            np.testing.assert_allclose(actual, dataset[variable], rtol=1e-5)


def test_csv_files_have_the_axes_of_all_quantities(dataset, tmp_path):
    names = ["reflectance", "reflectance_stderr", "diffuse_reflectance_factor"]
    write_csv(dataset[names], tmp_path / "table.csv")
    frame = pd.read_csv(tmp_path / "table.csv")
    assert list(frame.columns[:4]) == [SIZE, "incidence_deg", "polar_deg", "wavelength"]
    assert len(frame) == 2 * 5 * 6 * 2


CONVERSIONS = {
    "isofit": lambda ds: convert_to_isofit(ds),
    "eradiate": lambda ds: convert_to_eradiate(
        ds, wavelength=500.0, n_cosines=3, n_azimuths=2, **COARSE
    ),
}
ZERO_TO_180 = "azimuth_deg = .*: must be from 0 to 180"
INVALID_DATASETS = {
    "no directions": (
        lambda: make_direction_dataset().rename(polar_deg="polar"), "table = .*must be with refl"
    ),
    "one polar angle": (
        lambda: make_direction_dataset(polar_deg=[0.0]), "polar_deg = .*at least two angles"
    ),
    "horizon": (
        lambda: make_direction_dataset(polar_deg=[0.0, 90.0]), "polar_deg = .*less than 90"
    ),
    "half the azimuths": (
        lambda: make_direction_dataset(azimuth_deg=[0.0, 45.0, 90.0]), ZERO_TO_180
    ),
    "full circle": (lambda: make_direction_dataset(azimuth_deg=[0.0, 180.0, 270.0]), ZERO_TO_180),
    "text": (
        lambda: make_direction_dataset().assign_coords(incidence_deg=["a", "b", "c", "d", "e"]),
        "incidence_deg = .*at least two angles",
    ),
    "a gap": (
        lambda: make_direction_dataset().where(lambda ds: ds.azimuth_deg > 0.0), "table = .*gaps"
    ),
}  # fmt: skip


@pytest.mark.parametrize("conversion", CONVERSIONS)
@pytest.mark.parametrize("name", INVALID_DATASETS)
def test_unsuitable_tables_are_rejected(name, conversion):
    make, message = INVALID_DATASETS[name]
    with pytest.raises(InvalidValue, match=f"^{message}"):
        CONVERSIONS[conversion](make())


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda ds: convert_to_isofit(ds.rename({SIZE: "a"})), "axis = 'optical_radius_um'"),
        (
            lambda ds: convert_to_isofit(ds.rename({SIZE: "specific_surface_area_m2_kg"})),
            "table = 'over .*must be over optical_radius_um .give optical_radius_um = 3e6/.917 spe",
        ),
        (
            lambda ds: convert_to_isofit(ds.isel(incidence_deg=3)),
            "table = 'reflectance_factor over .*give incidence_deg in the grid of splits.build_tab",
        ),
        (lambda ds: convert_to_isofit(ds, sza=0.0), "sza = .*left out, as it is free"),
        (
            lambda ds: convert_to_isofit(ds[["reflectance_factor"]]),
            "table = .*with diffuse_reflectance_factor, or with reflectance",
        ),
        (
            lambda ds: convert_to_isofit(
                ds.drop_vars("diffuse_reflectance_factor").isel(incidence_deg=[0, 1, 2])
            ),
            r"polar_deg = \[0.0, .*: must be from 0 to 40, as far as incidence_deg goes",
        ),
        (
            lambda ds: convert_to_eradiate(ds, wavelength=500.0),
            "optical_radius_um = None: must be given",
        ),
        (lambda ds: convert_to_eradiate(ds, **COARSE), "wavelength = None: must be given"),
        (
            lambda ds: convert_to_eradiate(ds, wavelength=700.0, **COARSE),
            "wavelength = 700.0: must be one of the table's 2 wavelengths, from 500 to 900 nm",
        ),
        (lambda ds: convert_to_eradiate(ds, n_cosines=1, **AT_500_NM), "n_cosines = 1"),
        (
            lambda ds: convert_to_eradiate(ds.isel(polar_deg=[0, 1, 2]), **AT_500_NM),
            "polar_deg = .*must be from 0 to at least 60",
        ),
        (
            lambda ds: convert_to_eradiate(ds.isel(incidence_deg=[1, 4]), **AT_500_NM),
            "incidence_deg = .*must be from 0 to at least 60",
        ),
    ],
)  # fmt: skip
def test_invalid_arguments_are_rejected(dataset, call, message):
    with pytest.raises(InvalidValue, match=f"^{message}"):
        call(dataset)
