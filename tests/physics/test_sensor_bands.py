"""Bands of a sensor in tables, retrievals and maps: one size of grains by every way."""

import numpy as np
import pytest
import xarray as xr

import splits
from splits.illumination.bands import as_bands, choose_band_wavelengths

SIZE, TRUE_SIZE, SUN = "optical_radius_um", 200.0, 60.0
SIZES = [50.0, 80.0, 120.0, 180.0, 270.0, 400.0, 600.0, 900.0]
NAMES = [f"sentinel_2a_{number}" for number in ("2", "3", "4", "8", "8A", "11", "12")]
QUIET = {"threads": 1, "max_stderr": 0.001}


@pytest.fixture(scope="module")
def bands():
    sensor = splits.sensor_bands("sentinel_2a")
    return {name: sensor[name] for name in NAMES}


@pytest.fixture(scope="module")
def made(bands):
    return splits.build_table(
        splits.Snow.natural, {SIZE: SIZES}, incidence_deg=SUN, bands=bands, **QUIET
    ).dataset


def average(bands, wavelengths, spectrum):
    """Return the means over bands by the trapezoidal rule on a fine grid."""
    means = []
    for band in bands.values():
        fine = np.linspace(*band["wavelength_nm"][[0, -1]], 20_001)
        response = np.interp(fine, band["wavelength_nm"], band["response"])
        values = np.interp(fine, wavelengths, spectrum)
        means.append(np.trapezoid(response * values, fine) / np.trapezoid(response, fine))
    return np.array(means)


@pytest.fixture(scope="module")
def exact(bands):
    """Means over bands of a spectrum at every nanometre of the bands."""
    inside = [np.arange(*np.round(one.limits_nm), 1.0) for one in as_bands(bands).values()]
    ends = [one.limits_nm[1] for one in as_bands(bands).values()]
    wavelengths = np.unique(np.concatenate([*inside, ends]))
    snow = splits.Snow.natural(optical_radius_um=TRUE_SIZE)
    spectrum = splits.spectrophotometer(snow, wavelengths, SUN, **QUIET).reflectance.values
    return average(bands, wavelengths, spectrum)


def check(value, stderr):
    """Check a retrieved size: within its error, which is that of noise of 1 %."""
    assert 0.5 < stderr < 2.0
    assert abs(value - TRUE_SIZE) < stderr


def retrieve(values, table, bands, **options):
    found = splits.retrieve(values, table, [SIZE], 0.01 * values, bands=bands, **options)
    check(found.dataset.value.item(), found.dataset.value_stderr.item())
    return found


def test_tables_of_a_sensor_have_its_wavelengths_and_means(made, bands, exact):
    """Differences from means of a spectrum at every nanometre are within the stated errors."""
    assert np.diff(made.wavelength).min() > 0.1
    for band in as_bands(bands).values():
        low, high = band.limits_nm
        near = made.wavelength.values[
            (made.wavelength > low - 5.0) & (made.wavelength < high + 5.0)
        ]
        assert near[0] <= low and near[-1] >= high and np.diff(near).max() <= 5.0 + 1e-9
    found = splits.Table(made).interp(optical_radius_um=TRUE_SIZE, bands=bands)
    assert found.band.values.tolist() == NAMES
    assert found.reflectance.dims == ("wavelength",)
    z = (found.band_reflectance.values - exact) / found.band_reflectance_stderr.values
    assert np.abs(z).max() < 3.0
    assert found.band_reflectance_stderr.max() < 3e-4
    retrieve(exact, splits.Table(made), bands)


def test_means_of_the_nodes_are_those_at_the_nodes(made, bands):
    for size in (SIZES[0], SIZES[3]):
        found = splits.Table(made).interp(optical_radius_um=size, bands=bands)
        for name in ("band_reflectance", "band_reflectance_stderr"):
            node = made[name].sel({SIZE: size})
            np.testing.assert_allclose(found[name], node, rtol=2e-3 if "err" in name else 1e-6)


def test_interpolated_means_are_retrieved(made, bands):
    table = splits.Table(made)
    values = table.interp(optical_radius_um=TRUE_SIZE, bands=bands).band_reflectance
    found = retrieve(values, table, bands).dataset.value.item()
    assert found == pytest.approx(TRUE_SIZE, abs=1e-3)
    assert retrieve(values.astype(float)[::-1], table, bands).dataset.value.item() == found


def test_maps_in_bands_are_retrieved(made, bands, exact):
    image = xr.DataArray(np.tile(exact, (2, 3, 1)), {"band": NAMES}, ("y", "x", "band"))
    noise = xr.DataArray(0.01 * exact, {"band": NAMES}, ("band",))
    found = splits.retrieve_map(image, splits.Table(made), [SIZE], noise, bands=bands, threads=1)
    assert found[SIZE].dims == ("y", "x") and "band" not in found.coords
    assert (found.quality_flag == 0).all()
    for value, stderr in zip(found[SIZE].values.flat, found[f"{SIZE}_stderr"].values.flat,
                             strict=True):  # fmt: skip
        check(value, stderr)


def test_reflectance_factors_under_a_sky_are_retrieved(bands):
    """Bands under a sky are weighted by irradiance; so is a response that contains it."""
    sky = splits.sky("midlatitude_winter")
    snow = splits.Snow.natural(optical_radius_um=TRUE_SIZE)
    options = {"polar_deg": [20.0], "azimuth_deg": [90.0], "relative_stderr": 0.003, "threads": 1}
    found = splits.hdrf(snow, sky, bands=bands, **options)
    np.testing.assert_allclose(found.irradiance_covered, 1.0)
    made = splits.build_table(
        splits.Snow.natural,
        {SIZE: SIZES, "polar_deg": [10, 20, 30], "azimuth_deg": [60, 90, 120]},
        incidence_deg=sky.zenith_deg, bands=bands, threads=1, max_stderr=0.003,
        quantities=["reflectance_factor", "diffuse_reflectance_factor"],
    ).dataset  # fmt: skip
    table = splits.Table(made)
    fraction = 1.0 - sky.compute_direct_fraction(table.dataset.wavelength.values)
    view = table.at_view(20.0, 90.0, diffuse_fraction=fraction)
    weighted = {
        name: {
            "wavelength_nm": band["wavelength_nm"],
            "response": band["response"]
            * np.interp(band["wavelength_nm"], sky.wavelength_nm, sky.total),
        }
        for name, band in bands.items()
    }
    values = found.band_reflectance_factor.squeeze(drop=True)
    retrieve(values, view, weighted, quantity="reflectance_factor")


def test_centres_in_place_of_bands_retrieve_another_size(bands, exact):
    """The bias of centres is far beyond the error that the noise of 1 % implies."""
    centres = average(bands, *([np.linspace(400.0, 2400.0, 2001)] * 2))
    wavelengths = np.unique(np.concatenate([centres - 10.0, centres, centres + 10.0]))
    table = splits.build_table(splits.Snow.natural, {SIZE: SIZES}, wavelengths, SUN, **QUIET)
    found = splits.retrieve((centres, exact), table, [SIZE], 0.01 * exact).dataset
    assert found.value.item() - TRUE_SIZE > 3.0 * found.value_stderr.item()


@pytest.mark.filterwarnings("ignore:interpolation of")  # only nodes are compared
def test_errors_of_means_contain_the_distance_of_wavelengths(bands):
    """Means from coarse wavelengths differ from those of fine ones by their errors."""
    fine = np.union1d(np.arange(430.0, 2330.1, 5.0), choose_band_wavelengths(as_bands(bands)))

    def measure(wavelengths):
        made = splits.build_table(
            splits.Snow.natural, {SIZE: SIZES[1:6:2]}, wavelengths, SUN, bands=bands, **QUIET
        ).dataset
        return made.band_reflectance.values, made.band_reflectance_stderr.values

    reference = measure(fine)[0]
    for step in (10.0, 20.0):
        z = []
        for shift in np.arange(0.0, step, step / 5.0):
            values, stderr = measure(np.append(np.arange(430.0 - shift, 2325.0, step), 2330.0))
            z.append((values - reference) / stderr)
        assert 0.3 < np.sqrt(np.mean(np.square(z))) < 1.2
        assert np.abs(z).max() < 5.0


def test_errors_of_profiles_contain_the_distance_of_wavelengths():
    """Bands with and without absorption edges, irradiances and absorbed powers at all depths."""
    snow = splits.Snow.natural(specific_surface_area_m2_kg=25, depth_m=0.1)
    sky = splits.sky("clear", 55.0)
    bands = {"visible": (400, 700), "infrared": (700, 1400), "edge": (980, 1080)}

    def measure(step, shift):
        inner = np.arange(300.0 + step, 2490.0 - step, step) + shift
        wavelengths = [300.0, *inner, 2490.0]
        return splits.radiation_profile(
            snow, sky, wavelengths, depth_m=[0.01, 0.03], bands=bands, **QUIET
        )

    reference = measure(2.0, 0.0)
    for step in (20.0, 40.0):
        z = []
        for found in (measure(step, 0.0), measure(step, 0.3 * step)):
            for name in ("downward_irradiance", "upward_irradiance", "absorbed_power"):
                # The light that falls on the top is exact.
                ratio = (found[name] - reference[name]) / found[f"{name}_stderr"]
                z.append(ratio.where(found[f"{name}_stderr"] > 0.0).values.ravel())
        assert 0.3 < np.sqrt(np.nanmean(np.square(np.concatenate(z)))) < 1.2
        assert np.nanmax(np.abs(np.concatenate(z))) < 5.0
