"""Labels of measurements: conditions, receivers and pulses agree with the model or are refused."""

import numpy as np
import pytest
import xarray as xr
from array_inputs import FIXED, MEASURED, SIZE, SOOT, TABLE, make_return_table
from direction_tables import make_direction_dataset
from formula_tables import W

import splits
from splits.core.validation import InvalidValue

SPECTRUM = xr.DataArray(MEASURED, {"wavelength": W}, ("wavelength",))
RETURNS = make_return_table().assign_attrs(incidence_deg=0.0)
RETURN = RETURNS.isel({SIZE: 2}, drop=True)[["return_rate", "delay_bounds"]]
RETURN = RETURN.assign_attrs(title="a return")


def retrieve(measured, **changes):
    return splits.retrieve(measured, TABLE, [SIZE], 0.0625, **({"fixed": FIXED} | changes)).dataset


@pytest.mark.parametrize(
    ("coordinates", "message"),
    [
        ({"incidence_deg": 60.0}, r"measured.incidence_deg = \[60.0\]: must be 30.0"),
        ({SOOT: 8.0}, r"measured.impurities_ng_g.black_carbon = \[8.0\]: must be 64.0"),
        ({"incidence_deg": "diffuse"}, r"measured.incidence_deg = \['diffuse'\]: must be 30.0"),
        ({"incidence_deg": np.float32(30.0), SIZE: 8.0, "site": "Sodankylä"}, ""),
    ],
)
def test_conditions_of_a_spectrum_are_those_of_the_table(coordinates, message):
    measured = SPECTRUM.assign_coords(coordinates)
    if not message:
        assert retrieve(measured).equals(retrieve(SPECTRUM))
        return
    with pytest.raises(InvalidValue, match=message):
        retrieve(measured)


def test_conditions_of_a_spectrum_are_those_of_the_medium():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20)
    measured = SPECTRUM.assign_coords(incidence_deg=60.0)
    keywords = {"free": {"specific_surface_area_m2_kg": (10, 40)}, "noise": 0.05}
    with pytest.raises(InvalidValue, match=r"measured.incidence_deg = \[60.0\]: must be 0.0"):
        splits.retrieve(measured, snow, **keywords)


@pytest.mark.parametrize("incidence", [75.0, "diffuse"])
def test_results_state_their_incidence(incidence):
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20)
    measured = splits.spectrophotometer(snow, [900.0, 1000.0], incidence).reflectance
    keywords = {"free": {"specific_surface_area_m2_kg": (5, 80)}, "noise": 0.005}
    with pytest.raises(InvalidValue, match=r"measured.incidence_deg = \[.*\]: must be 0.0"):
        splits.retrieve(measured, snow, **keywords)
    found = splits.retrieve(measured, snow, fixed={"incidence_deg": incidence}, **keywords).dataset
    assert abs(found.value.item() - 20.0) < 2.0 * found.value_stderr.item() < 6.0


def test_snowpacks_state_their_incidence():
    layer = {"thickness_m": 0.1, "density_kg_m3": 300.0, "specific_surface_area_m2_kg": 20.0}
    columns = {name: (("time", "layer"), [[value]] * 2) for name, value in layer.items()}
    packs = splits.SnowPacks(xr.Dataset(columns, {"time": [1, 2]})).with_sun_zenith([60.0, 75.0])
    for incidence, expected in (("sun", [60.0, 75.0]), (30.0, 30.0), ("diffuse", "diffuse")):
        spectra = splits.spectrophotometer(packs, [900.0], incidence)
        assert (spectra.reflectance.incidence_deg == expected).all()


def test_an_assumed_incidence_is_stated():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20)
    measured = splits.spectrophotometer(snow, [900.0, 1000.0]).reflectance
    keywords = {"free": {"specific_surface_area_m2_kg": (5, 80)}, "noise": 0.005}
    arrays = (measured.wavelength.values, measured.values)
    for given, fixed, is_assumed in (
        (measured, None, False), (arrays, {"incidence_deg": 0}, False), (arrays, None, True),
    ):  # fmt: skip
        text = str(splits.retrieve(given, snow, fixed=fixed, **keywords))
        assert ("! incidence_deg is not given, 0 is assumed" in text) == is_assumed


def test_results_of_other_quantities_and_conditions_are_rejected():
    snow = splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.05)
    sky = splits.sky("midlatitude_winter", 60)
    wavelength, view = [900.0, 1000.0], {"polar_deg": [0, 30], "azimuth_deg": [0, 180]}
    spectrum = splits.spectrophotometer(snow, wavelength)
    blue_sky = splits.albedo(snow, sky, wavelength)
    under_sky = splits.hdrf(snow, sky, wavelength, relative_stderr=0.1, **view)
    beam = splits.goniophotometer(snow, wavelength, 40, relative_stderr=0.1, **view)
    directions = [
        one.reflectance_factor.isel(polar_deg=1, azimuth_deg=0).rename("mine")
        for one in (under_sky.drop_vars("sky"), beam.drop_vars("incidence_deg"))
    ]
    for measured, message in (
        (spectrum.transmittance, r"measured\.name = 'transmittance': must be reflectance"),
        (spectrum.absorptance.to_series(), r"measured\.name = 'absorptance': must be reflectance"),
        (spectrum.transmittance.to_series().to_frame(), r"measured\.name = 'transmittance'"),
        (spectrum.reflectance.rename("brdf"), r"measured\.name = 'brdf': must be reflectance"),
        (blue_sky.albedo, r"measured\.sky = \['midlatitude_winter'\]: must be left out"),
        (directions[0], r"measured\.polar_deg = \[30.0\]: must be left out"),
        (directions[1], r"measured\.polar_deg = \[30.0\]: must be left out"),
        (beam.reflectance, r"measured\.incidence_deg = \[40.0\]: must be 0.0"),
        (under_sky.reflectance_factor.isel(polar_deg=0, azimuth_deg=0), "'reflectance_factor'"),
    ):
        with pytest.raises(InvalidValue, match=message):
            splits.retrieve(measured, snow, {"specific_surface_area_m2_kg": (5, 80)}, 0.01)
    named = blue_sky.albedo.drop_vars("sky")
    assert splits.retrieve(named, snow, {"specific_surface_area_m2_kg": (5, 80)}, 0.01)


@pytest.mark.parametrize(("polar", "azimuth"), [(30.0, 90.0), (20.0, 80.0)])
def test_directions_are_those_of_the_view(polar, azimuth):
    table = splits.Table(make_direction_dataset())
    measured = xr.DataArray([0.8, 0.7], {"wavelength": [500.0, 900.0], "polar_deg": polar,
                                         "azimuth_deg": azimuth}, ("wavelength",))  # fmt: skip
    view = {"incidence_deg": 20.0, "polar_deg": 20.0, "azimuth_deg": 90.0}
    with pytest.raises(InvalidValue, match=r"measured\.(polar|azimuth)_deg = "):
        splits.retrieve(measured, table, [SIZE], 0.05, fixed=view, quantity="reflectance_factor")


def test_noise_without_labels_is_in_the_order_of_the_measurement():
    noise = np.linspace(0.05, 0.1, W.size)
    expected = splits.retrieve(SPECTRUM, TABLE, [SIZE], noise, fixed=FIXED).dataset
    found = splits.retrieve(SPECTRUM[::-1], TABLE, [SIZE], noise[::-1], fixed=FIXED).dataset
    assert found.equals(expected)
    covariance = np.diag(noise[::-1] ** 2)
    found = splits.retrieve(SPECTRUM[::-1], TABLE, [SIZE], covariance, fixed=FIXED).dataset
    xr.testing.assert_allclose(found, expected)


def test_units_are_converted_or_refused():
    per_cent = (100.0 * SPECTRUM).assign_attrs(units="%")
    xr.testing.assert_allclose(retrieve(per_cent), retrieve(SPECTRUM))
    with pytest.raises(InvalidValue, match=r"measured\.units = 'sr-1'"):
        retrieve(SPECTRUM.assign_attrs(units="sr-1"))
    angstrom = SPECTRUM.copy()
    angstrom.wavelength.attrs["units"] = "angstrom"
    with pytest.raises(InvalidValue, match=r"measured\.wavelength\.units = 'angstrom': must be nm"):
        retrieve(angstrom)


@pytest.mark.parametrize(
    ("changes", "keywords", "message"),
    [
        ({"incidence_deg": 20.0}, {}, r"measured.incidence_deg = \[20.0\]: must be 0.0"),
        ({"acceptance_deg": 5.0}, {}, "measured.acceptance_deg = 5.0: must be left out"),
        ({"footprint_radius_m": 5.0}, {}, "measured.footprint_radius_m = 5.0: must be left out"),
        ({"pulse_s": 1e-3}, {}, "measured.pulse_s = 0.001: must be left out"),
        ({"pulse_s": 1e-3}, {"pulse": 5e-4}, "measured.pulse_s = 0.001: must be 0.0005"),
        ({"instrument": "time_of_flight"}, {"pulse": 5e-4}, "measured.pulse_s = None"),
    ],
)  # fmt: skip
def test_receiver_and_pulse_are_those_of_the_table(changes, keywords, message):
    measured = RETURN.isel(delay_s=[0, 1]).assign_attrs(changes)
    with pytest.raises(InvalidValue, match=message):
        splits.retrieve_return(measured, RETURNS, [SIZE], 0.05, **keywords)


def test_results_state_their_receiver_and_pulse():
    snow = splits.Snow(depth_m=0.005)
    pulse = {"delay_s": [0.0, 1e-11], "power": [1.0, 1.0]}
    light = splits.time_of_flight(
        snow, 800.0, rays=2, threads=1, acceptance_deg=5, footprint_radius_m=0.5, pulse=pulse
    )
    assert light.attrs["acceptance_deg"] == 5.0 and light.attrs["footprint_radius_m"] == 0.5
    assert light.attrs["pulse_delay_s"].tolist() == pulse["delay_s"]
    assert "pulse_s" not in splits.time_of_flight(snow, 800.0, rays=2, threads=1).attrs
