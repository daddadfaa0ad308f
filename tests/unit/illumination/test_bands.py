"""Bands of sensors: their responses, and integrals over them."""

from __future__ import annotations

import numpy as np
import pytest

import splits
from splits.illumination.bands import SENSORS, SpectralBand, as_bands

W = np.array([400.0, 500.0, 700.0, 1000.0])
SKY = {
    "wavelength_nm": [300, 600, 1200],
    "direct": [1.0, 3.0, 0.0],
    "diffuse": [1.0, 0.0, 1.0],
}


def test_weights_include_the_response():
    sky = splits.sky(SKY, 30.0)
    w, response = [450.0, 520.0, 800.0], [0.0, 1.0, 0.25]
    band = SpectralBand.from_input("bands.mine", {"wavelength_nm": w, "response": response})
    fine = np.linspace(450.0, 800.0, 2_000_001)
    weighted = np.interp(fine, sky.wavelength_nm, sky.total) * np.interp(fine, w, response)
    albedo = np.array([0.2, 0.9, 0.1, 0.4])
    exact = np.trapezoid(weighted * np.interp(fine, W, albedo), fine)
    assert sky.compute_weights(W, band) @ albedo == pytest.approx(exact, rel=1e-9)


def test_responses_are_read_from_files(tmp_path):
    path = tmp_path / "band.csv"
    path.write_text("wavelength_nm,response\n500,0\n550,1\n600,0\n", encoding="utf-8")
    band = SpectralBand.from_input("bands.green", str(path))
    assert band.limits_nm == (500.0, 600.0)
    assert len(band.sha256) == 64


@pytest.mark.parametrize(
    ("bands", "message"),
    [
        ({"a": {"wavelength_nm": [1, 2]}}, "a mapping of wavelength_nm, response"),
        ({"a": {"wavelength_nm": [1, 2], "response": [1]}}, "same length"),
        ({"a": {"wavelength_nm": [2, 1], "response": [1, 1]}}, "increasing"),
        ({"a": {"wavelength_nm": [1, 2], "response": [-1, 1]}}, "at least 0"),
        ({"a": {"wavelength_nm": [1, 2], "response": [0, 0]}}, "not 0 everywhere"),
        ("sentinel", "sentinel_2a"),
        ([(400, 700)], "a mapping of names to bands"),
    ],
)
def test_invalid_bands_are_rejected_in_one_line(bands, message):
    with pytest.raises(ValueError, match=message) as error:
        as_bands(bands)
    assert "\n" not in str(error.value)


def test_bands_of_two_sensors_can_be_combined():
    """Band names include the sensor, as band numbers alone would collide."""
    first, second = splits.sensor_bands("landsat_8"), splits.sensor_bands("modis_terra")
    assert len({**first, **second}) == len(first) + len(second)
    with pytest.raises(ValueError, match="bands = '1': must be names that differ as texts"):
        as_bands({1: (400, 500), "1": (600, 700)})


@pytest.mark.parametrize("name", SENSORS)
def test_sensors_have_bands_with_responses(name):
    bands = as_bands(name)
    assert len(bands) >= 6
    for band in bands.values():
        assert 0.8 < band.response.max() <= 1.0
        assert band.wavelength_nm[0] > 300.0
        assert band.wavelength_nm[-1] < 3000.0


def test_band_centres_match_published_values():
    """Band centres as published by the agencies (nm)."""
    expected = {
        ("sentinel_2a", "3"): 560.0,
        ("sentinel_2a", "8A"): 865.0,
        ("landsat_8", "4"): 655.0,
        ("modis_terra", "5"): 1240.0,
    }
    for (name, label), middle in expected.items():
        band = as_bands(name)[f"{name}_{label}"]
        actual = (band.wavelength_nm * band.response).sum() / band.response.sum()
        assert actual == pytest.approx(middle, abs=8.0)
