"""Skies, and bands of sensors: spectral irradiances, responses, integrals and means over them."""

import builtins
import re

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from chi2 import NEEDS_JIT, compare_results, compute_z_bound

import splits
from splits.core.validation import InvalidValue
from splits.illumination.bands import (
    GAUSSIAN_SENSORS,
    PYRSR_SENSORS,
    SENSORS,
    SpectralBand,
    as_bands,
    load_band_centres,
)
from splits.illumination.sky import ATMOSPHERE, list_sky_names
from splits.instruments.sky_mixing import mix_direct_and_diffuse

W = np.array([400.0, 500.0, 700.0, 1000.0])
OWN_SKY = {"wavelength_nm": [300, 600, 1200], "direct": [1.0, 3.0, 0.0], "diffuse": [1.0, 0.0, 1.0]}


def test_weights_are_integrals_over_linear_basis_functions():
    sky = splits.sky(OWN_SKY, 30.0)
    fine = np.linspace(450.0, 900.0, 2_000_001)
    irradiance = np.interp(fine, sky.wavelength_nm, sky.total)
    for albedo in (np.ones(4), W / 1000.0, np.array([0.2, 0.9, 0.1, 0.4])):
        exact = np.trapezoid(irradiance * np.interp(fine, W, albedo), fine)
        integral = sky.compute_weights(W, SpectralBand.from_limits(450.0, 900.0)) @ albedo
        assert integral == pytest.approx(exact, rel=1e-9)
    # There is no irradiance outside the wavelengths or the range of the sky.
    wide, narrow = (
        sky.compute_weights(W, SpectralBand.from_limits(*e)).sum()
        for e in ((300, 5000), (400, 1000))
    )
    assert wide == narrow
    assert (sky.compute_weights(W, SpectralBand.from_limits(1100.0, 1200.0)) == 0.0).all()


FRAME = pd.DataFrame(OWN_SKY)


def test_data_frames_equal_mappings_of_lists():
    for frame in (FRAME, FRAME[["diffuse", "wavelength_nm", "direct"]],
                  FRAME.set_index("wavelength_nm")):  # fmt: skip
        assert splits.sky(frame, 50.0) == splits.sky(OWN_SKY, 50.0)
    response = FRAME[["wavelength_nm", "direct"]].rename(columns={"direct": "response"})
    assert SpectralBand.from_input("mine", response) == SpectralBand.from_input(
        "mine", response.to_dict("list")
    )
    albedo = pd.DataFrame({"wavelength_nm": [200, 3000], "albedo": [0.1, 0.2]})
    assert splits.Snow(ground=albedo) == splits.Snow(ground=albedo.to_dict("list"))
    index = pd.DataFrame({"wavelength_nm": [200, 3000], "n": [1.3, 1.4], "k": [0.0, 0.0]})
    one, other = ({"ice": table} for table in (index, index.to_dict("list")))
    assert splits.Snow(refractive_index=one) == splits.Snow(refractive_index=other)


@pytest.mark.parametrize(
    "invalid",
    [FRAME[["direct"]], FRAME.direct, np.ones(3), [1.0, 2.0], None, 3.0, xr.DataArray(np.ones(3)),
     xr.Dataset(), splits.sky()],
)  # fmt: skip
def test_invalid_sky_types_are_rejected_in_one_line(invalid):
    with pytest.raises(InvalidValue, match=r"^sky = .*: must be (one of|a mapping of) ") as error:
        splits.sky(invalid)
    assert "\n" not in str(error.value)


def test_direct_fraction_is_the_ratio_of_irradiances():
    np.testing.assert_allclose(
        splits.sky(OWN_SKY, 50.0).compute_direct_fraction(np.array([300.0, 450.0, 600.0, 1200.0])),
        [0.5, 2.0 / 2.5, 1.0, 0.0],
    )


def test_uncovered_ground_spectrum_error_suggests_a_range():
    medium, hint = splits.Snow(ground="camborthid"), r"such as wavelength_nm=range\((.*), 10\)"
    with pytest.raises(ValueError, match=hint) as error:
        splits.albedo(medium, splits.sky(OWN_SKY, 50.0))
    assert re.search(hint, str(error.value))[1] == "400, 1001"
    # The suggested wavelengths are covered by the ground and by the sky.
    w = np.arange(400.0, 1001.0, 10.0)
    assert (
        medium.ground.albedo(w).size
        == splits.sky(OWN_SKY, 50.0).compute_direct_fraction(w).size
        == 61
    )
    with pytest.raises(ValueError, match=r"range of the sky table .*range\(400, 1201, 10\)"):
        splits.sky(OWN_SKY, 50.0).check_coverage(np.array([400.0, 1200.0, 1210.0]))


@pytest.mark.parametrize("name", list_sky_names())
def test_skies_of_snicar_are_direct_or_diffuse(name):
    fraction = splits.sky(name).compute_direct_fraction(np.array([350.0, 1000.0, 2400.0]))
    np.testing.assert_array_equal(fraction, 0.0 if name.endswith("_cloudy") else 1.0)
    assert splits.sky(name).total.sum() == pytest.approx(1.0, abs=0.003)


def test_clear_and_standard_skies_match_known_irradiances():
    high_sun, low_sun = splits.sky("clear", 20.0), splits.sky("clear", 75.0)
    # The direct beam loses more blue light on a longer path.
    blue = np.array([400.0, 450.0])
    assert (low_sun.compute_direct_fraction(blue) < high_sun.compute_direct_fraction(blue)).all()
    # About 1 kW m⁻² for a high sun over dark ground.
    over_dark_ground = splits.sky("clear", 20.0, ground_albedo=0.1)
    assert np.trapezoid(over_dark_ground.total, over_dark_ground.wavelength_nm) == pytest.approx(
        1000.0, rel=0.1
    )
    standard = splits.sky("astm_g173")
    direct = np.trapezoid(standard.direct, standard.wavelength_nm)
    assert direct == pytest.approx(900.1 * np.cos(np.radians(48.19)), rel=1e-3)
    snow, soil = (splits.sky("clear", 60.0, ground_albedo=albedo) for albedo in (0.9, 0.1))
    assert snow.diffuse.sum() > soil.diffuse.sum()


@pytest.mark.parametrize(
    ("definition", "keywords", "message"),
    [
        ("midlatitude", {}, "did you mean midlatitude_winter"),
        (3, {}, "must be one of"),
        ("clear", {"zenith_deg": 95.0}, "zenith_deg"),
        ("clear", {"zenith_deg": 50.0, "turbidity": 0.1}, "turbidity_500nm"),
        ("midlatitude_winter", {"zenith": 50.0}, "did you mean zenith_deg"),
        ("clear", {"zenith_deg": 50.0, "ground_albedo": 2.0}, "ground_albedo"),
        ("high_mountain", {"ozone_atm_cm": 0.3}, "applies to the sky clear only"),
        ("astm_g173", {"zenith_deg": 30.0}, "left out"),
        ("no.csv", {}, "an existing CSV file"),
        ({"direct": [1, 2]}, {}, "a mapping of wavelength_nm"),
        (OWN_SKY | {"direct": [1.0, 2.0]}, {}, "lists of the same length"),
        (OWN_SKY | {"direct": [1.0, -2.0, 0.0]}, {}, r"sky\.direct"),
        (OWN_SKY | {"direct": [0, 0, 0], "diffuse": [0, 0, 0]}, {}, "light at some wavelength"),
        (OWN_SKY | {"wavelength_nm": [300, 200, 400]}, {}, "strictly increasing"),
        ("clear", {}, "zenith_deg = None: must be given"),
        (OWN_SKY, {}, "zenith_deg = None: must be given"),
    ],
)
def test_invalid_skies_are_rejected_in_one_line(definition, keywords, message):
    unknown = not set(keywords) <= {"zenith_deg", *ATMOSPHERE}
    with pytest.raises(TypeError if unknown else ValueError, match=message) as error:
        splits.sky(definition, **keywords)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wavelength_nm": [250.0, 500.0]}, r"in \[300, 1200\] nm"),
        ({"wavelength_nm": [500.0]}, "at least 2"),
        ({"bands": {"red": (700, 600)}}, r"bands\.red"),
        ({"bands": {"thermal": (8000, 9000)}}, r"bands\.thermal"),
        ({"bands": {"broadband": (400, 500)}}, r"bands\.broadband = .* left out"),
    ],
)
def test_wavelengths_outside_a_sky_are_rejected(changes, message):
    arguments = {"wavelength_nm": W} | changes
    with pytest.raises(ValueError, match=message):
        splits.albedo(
            splits.ParticleLayer(optical_thickness=0.1),
            splits.sky(OWN_SKY, 50.0),
            max_stderr=0.1,
            **arguments,
        )
    if "wavelength_nm" not in changes:
        with pytest.raises(ValueError, match=message):
            splits.radiation_profile(
                splits.Snow(),
                splits.sky(OWN_SKY, 50.0),
                depth_m=[0.01],
                max_stderr=0.1,
                **arguments,
            )


def test_a_sky_records_its_inputs():
    pytest.importorskip("pvlib")
    clear = splits.sky("clear", zenith_deg=30, turbidity_500nm=0.9)
    assert "turbidity_500nm 0.9" in clear.source and "ground_albedo 0.8" in clear.source
    other = OWN_SKY | {"direct": [1.0, 3.0, 0.1]}
    assert len({splits.sky(definition, 50.0).sha256 for definition in (OWN_SKY, other)} - {""}) == 2


def test_interpolation_bounds_of_direct_and_diffuse_add_linearly():
    def run(incidence, index):
        batches = [[0.003 + 0.001 * index], [0.0]]
        return xr.Dataset(
            {
                "x": ("wavelength", [0.5]),
                "x_stderr": ("wavelength", [np.hypot(batches[0][0], 0.01)]),
                "x_batches": (("batch", "wavelength"), batches),
            },
            {"wavelength": [500.0]},
            {
                "solver": "monte_carlo",
                "stop_reason": ("max_rays", "converged")[index],
                "rays": 100 + index,
            },
        )

    sky = splits.sky(OWN_SKY, 50.0)
    mixed = mix_direct_and_diffuse(sky, np.array([500.0]), run, ["x"])
    fraction = float(sky.compute_direct_fraction(np.array([500.0]))[0])
    scatter = np.hypot(0.003 * fraction, 0.004 * (1.0 - fraction))
    assert 0.0 < fraction < 1.0
    assert float(mixed.x_stderr[0]) == pytest.approx(np.hypot(scatter, 0.01), rel=1e-12)
    assert mixed.attrs == {"solver": "monte_carlo", "stop_reason": "max_rays", "rays": 201}


@pytest.mark.slow
def test_a_white_layer_is_white_over_all_bands():
    white = splits.ParticleLayer(optical_thickness=1.0, single_scattering_albedo=1.0, ground=1.0)
    result = splits.albedo(
        white, splits.sky(OWN_SKY, 50.0), W, max_stderr=0.02, bands={"green": (500, 560)}
    )
    assert result.band.values.tolist() == ["broadband", "green"]
    np.testing.assert_allclose(result.band_albedo, 1.0, atol=1e-12)
    sky = splits.sky(OWN_SKY, 50.0)
    inside, total = sky.compute_weights(W, SpectralBand.from_limits(300, 1200)).sum(), 1950.0
    assert result.irradiance_covered[0] == pytest.approx(inside / total)
    assert result.irradiance_covered[1] == pytest.approx(1.0)


@NEEDS_JIT
@pytest.mark.slow
def test_albedo_mixes_direct_and_diffuse_reflectance():
    snow = splits.Snow(depth_m=0.03)
    result = splits.albedo(snow, splits.sky(OWN_SKY, 50.0), W, max_stderr=0.02, seed=5)
    sun = splits.spectrophotometer(snow, W, 50.0, max_stderr=0.02, seed=5).reflectance
    diffuse = splits.spectrophotometer(snow, W, "diffuse", max_stderr=0.02, seed=6).reflectance
    fraction = result.direct_fraction
    np.testing.assert_allclose(
        result.albedo, fraction * sun + (1.0 - fraction) * diffuse, rtol=1e-12
    )


@NEEDS_JIT
@pytest.mark.long
def test_band_errors_match_the_scatter_between_seeds():
    snow, sky = splits.Snow(depth_m=0.03), splits.sky(OWN_SKY, 50.0)
    w = np.arange(400.0, 1001.0, 25.0)
    runs = [
        splits.albedo(snow, sky, w, max_stderr=0.02, seed=2 * seed, bands={"blue": (400, 500)})
        for seed in range(60)
    ]
    values = np.array([run.band_albedo.values for run in runs])
    stated = np.sqrt(np.mean([run.band_albedo_stderr.values**2 for run in runs], axis=0))
    ratio = values.std(axis=0, ddof=1) / stated
    print("ratio of scatter to stated error", ratio)
    # The standard deviation of 60 seeds has a relative standard error of 9 %; three of these.
    assert (ratio < 1.28).all()
    assert (ratio > 0.5).all()


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
        ({"a": {"wavelength_nm": [501, 502], "response": [1]}}, "same length"),
        ({"a": {"wavelength_nm": [502, 501], "response": [1, 1]}}, "increasing"),
        ({"a": {"wavelength_nm": [501, 502], "response": [-1, 1]}}, "at least 0"),
        ({"a": {"wavelength_nm": [501, 502], "response": [0, 0]}}, "not 0 everywhere"),
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
    z = compare_results(found, exact, "band_albedo")
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
