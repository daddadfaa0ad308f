"""Skies: spectral irradiances, their integrals, and albedos under them."""

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
from splits.illumination.sky import ATMOSPHERE_PARAMETERS, list_sky_names
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
    unknown = not set(keywords) <= {"zenith_deg", *ATMOSPHERE_PARAMETERS}
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
                splits.Snow(), splits.sky(OWN_SKY, 50.0), [0.01], max_stderr=0.1, **arguments
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
    white = splits.ParticleLayer(
        optical_thickness=1.0, single_scattering_albedo=1.0, bottom_albedo=1.0
    )
    result = splits.albedo(white, splits.sky(OWN_SKY, 50.0), W, 0.02, bands={"green": (500, 560)})
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
    result = splits.albedo(snow, splits.sky(OWN_SKY, 50.0), W, 0.02, seed=5)
    sun = splits.spectrophotometer(snow, W, 50.0, 0.02, seed=5).reflectance
    diffuse = splits.spectrophotometer(snow, W, "diffuse", 0.02, seed=6).reflectance
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
        splits.albedo(snow, sky, w, 0.02, seed=2 * seed, bands={"blue": (400, 500)})
        for seed in range(60)
    ]
    values = np.array([run.band_albedo.values for run in runs])
    stated = np.sqrt(np.mean([run.band_albedo_stderr.values**2 for run in runs], axis=0))
    ratio = values.std(axis=0, ddof=1) / stated
    print("ratio of scatter to stated error", ratio)
    # The standard deviation of 60 seeds has a relative standard error of 9 %; three of these.
    assert (ratio < 1.28).all()
    assert (ratio > 0.5).all()
