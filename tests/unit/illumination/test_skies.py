"""Light of the sky: its irradiances, their integrals, and albedos under them."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from chi2 import NEEDS_JIT

import splits
from splits.core.validation import InvalidValue
from splits.illumination.bands import SpectralBand
from splits.illumination.sky_spectra import ATMOSPHERE_PARAMETERS, list_sky_names
from splits.instruments.sky_mixing import mix_direct_and_diffuse

W = np.array([400.0, 500.0, 700.0, 1000.0])
OWN_SKY = {"wavelength_nm": [300, 600, 1200], "direct": [1.0, 3.0, 0.0], "diffuse": [1.0, 0.0, 1.0]}


def test_weights_are_integrals_of_irradiance_times_hats():
    mine = splits.sky(OWN_SKY, 30.0)
    fine = np.linspace(450.0, 900.0, 2_000_001)
    light = np.interp(fine, mine.wavelength_nm, mine.total)
    for albedo in (np.ones(4), W / 1000.0, np.array([0.2, 0.9, 0.1, 0.4])):
        exact = np.trapezoid(light * np.interp(fine, W, albedo), fine)
        found = mine.compute_weights(W, SpectralBand.from_limits(450.0, 900.0)) @ albedo
        assert found == pytest.approx(exact, rel=1e-9)
    # Light beyond the wavelengths, or beyond the sky, is not there.
    wide, narrow = (
        mine.compute_weights(W, SpectralBand.from_limits(*e)).sum()
        for e in ((300, 5000), (400, 1000))
    )
    assert wide == narrow
    assert (mine.compute_weights(W, SpectralBand.from_limits(1100.0, 1200.0)) == 0.0).all()


FRAME = pd.DataFrame(OWN_SKY)


def test_columns_of_a_frame_are_taken_as_lists_of_these_names():
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
    "given",
    [FRAME[["direct"]], FRAME.direct, np.ones(3), [1.0, 2.0], None, 3.0, xr.DataArray(np.ones(3)),
     xr.Dataset(), splits.sky()],
)  # fmt: skip
def test_what_is_no_sky_is_refused_in_a_line(given):
    with pytest.raises(InvalidValue, match=r"^sky = .*: must be (one of|a mapping of) ") as refused:
        splits.sky(given)
    assert "\n" not in str(refused.value)


def test_direct_share_is_that_of_irradiances():
    np.testing.assert_allclose(
        splits.sky(OWN_SKY, 50.0).compute_direct_fraction(np.array([300.0, 450.0, 600.0, 1200.0])),
        [0.5, 2.0 / 2.5, 1.0, 0.0],
    )


def test_a_ground_that_knows_less_than_the_sky_says_how_to_go_on():
    medium, how = splits.Snow(ground="camborthid"), r"such as wavelength_nm=range\((.*), 10\)"
    with pytest.raises(ValueError, match=how) as caught:
        splits.albedo(medium, splits.sky(OWN_SKY, 50.0))
    assert re.search(how, str(caught.value))[1] == "400, 1001"
    # Those are known to the ground and to the sky.
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
    share = splits.sky(name).compute_direct_fraction(np.array([350.0, 1000.0, 2400.0]))
    np.testing.assert_array_equal(share, 0.0 if name.endswith("_cloudy") else 1.0)
    assert splits.sky(name).total.sum() == pytest.approx(1.0, abs=0.003)


def test_clear_skies_and_the_standard():
    high, low = splits.sky("clear", 20.0), splits.sky("clear", 75.0)
    # The beam loses more of its blue the longer its way.
    blue = np.array([400.0, 450.0])
    assert (low.compute_direct_fraction(blue) < high.compute_direct_fraction(blue)).all()
    # The sun high over dark ground: about a kilowatt.
    dark = splits.sky("clear", 20.0, ground_albedo=0.1)
    assert np.trapezoid(dark.total, dark.wavelength_nm) == pytest.approx(1000.0, rel=0.1)
    standard = splits.sky("astm_g173")
    beam = np.trapezoid(standard.direct, standard.wavelength_nm)
    assert beam == pytest.approx(900.1 * np.cos(np.radians(48.19)), rel=1e-3)
    snow, soil = (splits.sky("clear", 60.0, ground_albedo=one) for one in (0.9, 0.1))
    assert snow.diffuse.sum() > soil.diffuse.sum()


@pytest.mark.parametrize(
    ("given", "more", "text"),
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
        (OWN_SKY | {"direct": [1.0, 2.0]}, {}, "three lists of the same length"),
        (OWN_SKY | {"direct": [1.0, -2.0, 0.0]}, {}, r"sky\.direct"),
        (OWN_SKY | {"direct": [0, 0, 0], "diffuse": [0, 0, 0]}, {}, "light at some wavelength"),
        (OWN_SKY | {"wavelength_nm": [300, 200, 400]}, {}, "strictly increasing"),
        ("clear", {}, "zenith_deg = None: must be given"),
        (OWN_SKY, {}, "zenith_deg = None: must be given"),
    ],
)
def test_bad_skies_are_refused_in_one_line(given, more, text):
    unknown = not set(more) <= {"zenith_deg", *ATMOSPHERE_PARAMETERS}
    with pytest.raises(TypeError if unknown else ValueError, match=text) as error:
        splits.sky(given, **more)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("more", "text"),
    [
        ({"wavelength_nm": [250.0, 500.0]}, r"in \[300, 1200\] nm"),
        ({"wavelength_nm": [500.0]}, "at least 2"),
        ({"bands": {"red": (700, 600)}}, r"bands\.red"),
        ({"bands": {"thermal": (8000, 9000)}}, r"bands\.thermal"),
        ({"bands": {"broadband": (400, 500)}}, r"bands\.broadband = .* left out"),
    ],
)
def test_what_a_sky_cannot_tell_is_refused(more, text):
    given = {"wavelength_nm": W} | more
    with pytest.raises(ValueError, match=text):
        splits.albedo(
            splits.ParticleLayer(optical_thickness=0.1),
            splits.sky(OWN_SKY, 50.0),
            max_stderr=0.1,
            **given,
        )
    if "wavelength_nm" not in more:
        with pytest.raises(ValueError, match=text):
            splits.radiation_profile(
                splits.Snow(), splits.sky(OWN_SKY, 50.0), [0.01], max_stderr=0.1, **given
            )


def test_inputs_of_a_sky_are_known_afterwards():
    pytest.importorskip("pvlib")
    clear = splits.sky("clear", zenith_deg=30, turbidity_500nm=0.9)
    assert "turbidity_500nm 0.9" in clear.source and "ground_albedo 0.8" in clear.source
    other = OWN_SKY | {"direct": [1.0, 3.0, 0.1]}
    assert len({splits.sky(one, 50.0).sha256 for one in (OWN_SKY, other)} - {""}) == 2


def test_what_interpolation_misses_of_sun_and_sky_is_added_up_in_size():
    def run(incidence, number):
        groups = [[0.003 + 0.001 * number], [0.0]]
        return xr.Dataset(
            {
                "x": ("wavelength", [0.5]),
                "x_stderr": ("wavelength", [np.hypot(groups[0][0], 0.01)]),
                "x_batches": (("batch", "wavelength"), groups),
            },
            {"wavelength": [500.0]},
        )

    light = splits.sky(OWN_SKY, 50.0)
    found = mix_direct_and_diffuse(light, np.array([500.0]), run, ["x"])
    share = float(light.compute_direct_fraction(np.array([500.0]))[0])
    scatter = np.hypot(0.003 * share, 0.004 * (1.0 - share))
    assert 0.0 < share < 1.0
    assert float(found.x_stderr[0]) == pytest.approx(np.hypot(scatter, 0.01), rel=1e-12)


@pytest.mark.slow
def test_a_white_layer_is_white_over_all_bands():
    white = splits.ParticleLayer(
        optical_thickness=1.0, single_scattering_albedo=1.0, bottom_albedo=1.0
    )
    found = splits.albedo(white, splits.sky(OWN_SKY, 50.0), W, 0.02, bands={"green": (500, 560)})
    assert found.band.values.tolist() == ["broadband", "green"]
    np.testing.assert_allclose(found.band_albedo, 1.0, atol=1e-12)
    mine = splits.sky(OWN_SKY, 50.0)
    inside, everything = mine.compute_weights(W, SpectralBand.from_limits(300, 1200)).sum(), 1950.0
    assert found.irradiance_covered[0] == pytest.approx(inside / everything)
    assert found.irradiance_covered[1] == pytest.approx(1.0)


@NEEDS_JIT
@pytest.mark.slow
def test_the_sky_mixes_the_sun_and_diffuse_light():
    snow = splits.Snow(depth_m=0.03)
    found = splits.albedo(snow, splits.sky(OWN_SKY, 50.0), W, 0.02, seed=5)
    sun = splits.spectrophotometer(snow, W, 50.0, 0.02, seed=5).reflectance
    rest = splits.spectrophotometer(snow, W, "diffuse", 0.02, seed=6).reflectance
    share = found.direct_fraction
    np.testing.assert_allclose(found.albedo, share * sun + (1.0 - share) * rest, rtol=1e-12)


@NEEDS_JIT
@pytest.mark.long
def test_errors_of_bands_are_their_scatter_between_seeds():
    snow, mine = splits.Snow(depth_m=0.03), splits.sky(OWN_SKY, 50.0)
    w = np.arange(400.0, 1001.0, 25.0)
    runs = [
        splits.albedo(snow, mine, w, 0.02, seed=2 * seed, bands={"blue": (400, 500)})
        for seed in range(60)
    ]
    values = np.array([run.band_albedo.values for run in runs])
    stated = np.sqrt(np.mean([run.band_albedo_stderr.values**2 for run in runs], axis=0))
    ratio = values.std(axis=0, ddof=1) / stated
    print("scatter over stated", ratio)
    # 60 seeds know a scatter to 9 %; three times that.
    assert (ratio < 1.28).all()
    assert (ratio > 0.5).all()
