"""Gaussian bands of sensors: centres, widths, and means over them."""

from __future__ import annotations

import builtins

import numpy as np
import pytest
from chi2 import compute_z_bound

import splits
from splits.illumination.bands import (
    GAUSSIAN_SENSORS,
    PYRSR_SENSORS,
    SENSORS,
    as_bands,
    load_band_centres,
)

CONSTANT_SKY = splits.sky(
    {"wavelength_nm": [300.0, 2700.0], "direct": [1.0, 1.0], "diffuse": [0.0, 0.0]}, 30.0
)
N_BANDS = {
    "emit": 285,
    "enmap": 224,
    "olci_sentinel_3a": 21,
    "prisma": 234,
    "slstr_sentinel_3a": 6,
    "viirs_suomi_npp": 14,
}
PUBLISHED = {
    ("emit", "1"): (381.0, 8.4),
    ("emit", "285"): (2492.9, 8.8),
    ("enmap", "1"): (418.4, 7.0),
    ("enmap", "91"): (993.3, 10.6),
    ("enmap", "92"): (902.0, 9.2),
    ("enmap", "224"): (2445.3, 7.2),
    ("olci_sentinel_3a", "Oa01"): (400.0, 15.0),
    ("olci_sentinel_3a", "Oa14"): (764.4, 3.75),
    ("olci_sentinel_3a", "Oa17"): (865.0, 20.0),
    ("olci_sentinel_3a", "Oa21"): (1020.0, 40.0),
    ("prisma", "VNIR1"): (402.5, 11.4),
    ("prisma", "SWIR1"): (943.0, 10.9),
    ("prisma", "SWIR171"): (2496.9, 9.5),
    ("slstr_sentinel_3a", "S1"): (554.3, 19.3),
    ("slstr_sentinel_3a", "S6"): (2255.7, 50.2),
    ("viirs_suomi_npp", "I1"): (638.0, 81.6),
    ("viirs_suomi_npp", "M5"): (671.4, 18.8),
    ("viirs_suomi_npp", "M11"): (2256.9, 46.3),
}
"""Centre and full width at half maximum (nm)."""


def compute_half_maxima(band):
    """Return the wavelengths (nm) on both sides of the maximum with half its response."""
    w, response = band["wavelength_nm"], band["response"]
    peak = response.argmax()
    return (
        np.interp(0.5, response[: peak + 1], w[: peak + 1]),
        np.interp(-0.5, -response[peak:], w[peak:]),
    )


@pytest.mark.parametrize(("name", "label"), PUBLISHED)
def test_bands_have_published_centres_and_widths(name, label):
    centre, width = PUBLISHED[name, label]
    low, high = compute_half_maxima(splits.sensor_bands(name)[f"{name}_{label}"])
    assert 0.5 * (low + high) == pytest.approx(centre, abs=0.06)
    assert high - low == pytest.approx(width, abs=0.06)


@pytest.mark.parametrize("name", GAUSSIAN_SENSORS)
def test_all_bands_are_in_the_table(name):
    bands = splits.sensor_bands(name)
    assert len(bands) == N_BANDS[name] == (load_band_centres().sensor == name).sum()
    for band in bands.values():
        low, high = band["wavelength_nm"][[0, -1]]
        assert band["response"].max() == 1.0
        assert band["response"].min() == pytest.approx(2.0**-9)
        assert 320.0 < low < high < 2600.0


@pytest.mark.parametrize(("name", "gaps"), [("emit", 0), ("enmap", 3), ("prisma", 1)])
def test_bands_of_spectrometers_have_no_outliers(name, gaps):
    """Steps between neighbours are 4 to 13 nm except between detectors and in gaps of EnMAP."""
    rows = load_band_centres()[load_band_centres().sensor == name]
    steps = np.diff(rows.centre_nm)
    regular = (steps > 4.0) & (steps < 13.0)
    assert (~regular).sum() == gaps
    assert np.abs(np.diff(rows.width_nm))[regular].max() < 1.4
    assert rows.width_nm.between(5.0, 16.0).all()


@pytest.mark.parametrize("name", GAUSSIAN_SENSORS)
def test_mean_of_a_linear_spectrum_is_its_value_at_the_centre(name):
    """Under constant irradiance, as a Gaussian is symmetric."""
    wavelengths = np.arange(300.0, 2700.1, 50.0)
    albedo = 0.9 - 3e-4 * (wavelengths - 300.0)
    rows = load_band_centres()[load_band_centres().sensor == name]
    for band, centre in zip(as_bands(name).values(), rows.centre_nm, strict=True):
        weights = CONSTANT_SKY.compute_weights(wavelengths, band)
        mean = weights @ albedo / weights.sum()
        assert mean == pytest.approx(0.9 - 3e-4 * (centre - 300.0), abs=1e-12)


@pytest.mark.parametrize("label", ["emit_100", "viirs_suomi_npp_M7", "prisma_SWIR50"])
def test_sampled_response_has_the_moments_of_a_gaussian(label):
    """Area within 0.1 %, and mean of a parabola within 1 % of its difference from the centre."""
    name, _, number = label.rpartition("_")
    table = load_band_centres()
    row = table[(table.sensor == name) & (table.band == number)].iloc[0]
    band = as_bands(name)[label]
    fine = np.linspace(*band.limits_nm, 20_001)
    response = np.interp(fine, band.wavelength_nm, band.response)
    sigma = row.width_nm / np.sqrt(8.0 * np.log(2.0))
    assert np.trapezoid(response, fine) == pytest.approx(np.sqrt(2.0 * np.pi) * sigma, rel=1e-3)
    variance = np.average((fine - row.centre_nm) ** 2, weights=response)
    assert variance == pytest.approx(sigma**2, rel=0.01)


@pytest.mark.parametrize("name", GAUSSIAN_SENSORS)
@pytest.mark.parametrize(
    "sky", ["midlatitude_winter", "summit_greenland", "subarctic_summer_cloudy"]
)
def test_all_bands_have_light_at_default_wavelengths(name, sky):
    spectrum = splits.sky(sky)
    wavelengths = np.arange(spectrum.wavelength_nm[0], 2495.1, 10.0)
    spectrum.check_bands(spectrum.make_bands(name), wavelengths)


def test_albedos_of_285_bands_are_means_of_the_spectrum():
    """Sums over a fine grid, of irradiance times response times albedo."""
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20)
    sky = splits.sky("midlatitude_winter")
    found = splits.albedo(snow, sky, solver="discrete_ordinates", bands="emit")
    assert found.band_albedo.sizes == {"band": 286}
    # Bands are narrower than the steps of 10 nm, where the albedo has edges, as near 1400 nm.
    exact = splits.albedo(
        snow, sky, np.arange(305.0, 2496.0), solver="discrete_ordinates", bands="emit"
    )
    z = (found.band_albedo - exact.band_albedo) / np.hypot(
        found.band_albedo_stderr, exact.band_albedo_stderr
    )
    assert (found.band_albedo_stderr > 0.0).all()
    assert 0.5 < np.sqrt((z**2).mean()) < 1.2 and np.abs(z).max() < compute_z_bound(z.size)
    fine = np.arange(305.0, 2495.0, 0.01)
    albedo = np.interp(fine, found.wavelength, found.albedo)
    irradiance = np.interp(fine, sky.wavelength_nm, sky.total)
    for label in ("emit_1", "emit_90", "emit_150", "emit_285"):
        band = as_bands("emit")[label]
        response = np.interp(fine, band.wavelength_nm, band.response, left=0.0, right=0.0)
        expected = np.average(albedo, weights=irradiance * response)
        assert float(found.band_albedo.sel(band=label)) == pytest.approx(expected, abs=2e-5)
    covered = found.irradiance_covered.sel(band=["emit_1", "emit_284", "emit_285"]).values
    assert covered[0] == pytest.approx(1.0)
    assert covered[1] > covered[2] > 0.5


def test_bands_outside_the_wavelengths_are_rejected_in_one_line():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20)
    sky = splits.sky("midlatitude_winter")
    with pytest.raises(ValueError, match=r"bands\.emit_1 = .*between 500 and 900 nm") as error:
        splits.albedo(snow, sky, [500.0, 900.0], bands="emit")
    assert "\n" not in str(error.value)


def test_sensors_without_tables_of_pyrsr_do_not_import_it(monkeypatch):
    original = builtins.__import__

    def reject_pyrsr(name, *arguments, **keywords):
        if name.partition(".")[0] == "pyrsr":
            raise ModuleNotFoundError(name, name="pyrsr")
        return original(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", reject_pyrsr)
    for name in GAUSSIAN_SENSORS:
        assert splits.sensor_bands(name)


def test_unknown_sensors_are_rejected():
    with pytest.raises(ValueError, match=r"sensor = 'olci'.*olci_sentinel_3a"):
        splits.sensor_bands("olci")
    assert set(SENSORS) == {*PYRSR_SENSORS, *GAUSSIAN_SENSORS}
    assert set(load_band_centres().sensor) == set(GAUSSIAN_SENSORS)


def test_responses_can_be_changed_without_effect_on_the_next():
    first = splits.sensor_bands("slstr_sentinel_3a")
    first["slstr_sentinel_3a_S1"]["response"][:] = 0.0
    again = splits.sensor_bands("slstr_sentinel_3a")
    assert again["slstr_sentinel_3a_S1"]["response"].max() == 1.0
    assert again["slstr_sentinel_3a_S2"]["response"].max() == 1.0
