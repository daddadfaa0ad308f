"""Bands of sensors: their responses, and integrals over them."""

from __future__ import annotations

import numpy as np
import pytest

import splits
from splits.illumination.bands import SENSORS, SpectralBand, as_bands

W = np.array([400.0, 500.0, 700.0, 1000.0])
OWN_BANDS = {
    "wavelength_nm": [300, 600, 1200],
    "direct": [1.0, 3.0, 0.0],
    "diffuse": [1.0, 0.0, 1.0],
}


def test_weights_are_integrals_of_responses_too():
    mine = splits.sky(OWN_BANDS, 30.0)
    w, response = [450.0, 520.0, 800.0], [0.0, 1.0, 0.25]
    band = SpectralBand.from_input("bands.mine", {"wavelength_nm": w, "response": response})
    fine = np.linspace(450.0, 800.0, 2_000_001)
    light = np.interp(fine, mine.wavelength_nm, mine.total) * np.interp(fine, w, response)
    albedo = np.array([0.2, 0.9, 0.1, 0.4])
    exact = np.trapezoid(light * np.interp(fine, W, albedo), fine)
    assert mine.compute_weights(W, band) @ albedo == pytest.approx(exact, rel=1e-9)


def test_a_response_may_come_from_a_file(tmp_path):
    path = tmp_path / "band.csv"
    path.write_text("wavelength_nm,response\n500,0\n550,1\n600,0\n", encoding="utf-8")
    band = SpectralBand.from_input("bands.green", str(path))
    assert band.limits_nm == (500.0, 600.0)
    assert len(band.sha256) == 64


@pytest.mark.parametrize(
    ("given", "text"),
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
def test_bad_bands_are_refused_in_one_line(given, text):
    with pytest.raises(ValueError, match=text) as error:
        as_bands(given)
    assert "\n" not in str(error.value)


def test_bands_of_two_sensors_stand_together():
    """Numbers of makers alone are the same, and a mapping keeps one of each."""
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


def test_known_bands_are_where_they_should_be():
    """Middles of bands as their agencies give them (nm)."""
    wanted = {
        ("sentinel_2a", "3"): 560.0,
        ("sentinel_2a", "8A"): 865.0,
        ("landsat_8", "4"): 655.0,
        ("modis_terra", "5"): 1240.0,
    }
    for (name, label), middle in wanted.items():
        band = as_bands(name)[f"{name}_{label}"]
        found = (band.wavelength_nm * band.response).sum() / band.response.sum()
        assert found == pytest.approx(middle, abs=8.0)
