"""Spectra of many snowpacks: equal to those one by one, flags, incidence, labels, files."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import splits
from splits.core.progress import Progress
from splits.discrete_ordinates import snow_packs
from splits.discrete_ordinates.snow_packs import estimate_bytes
from splits.instruments.snow_packs import RESULT_FLAGS

TIMES = pd.date_range("2024-02-01", periods=6, freq="h")
WAVELENGTHS = [400.0, 700.0, 900.0, 1300.0, 1800.0]
SOOT = "impurities_ng_g.black_carbon"
NAN = np.nan
ZENITH = np.array([10.0, 40.0, 60.0, 75.0, 85.0, 89.0])


def make_dataset(n_layers=3, **changes):
    """Return dry snowpacks; the last two have fewer layers than the others."""
    rng = np.random.default_rng(3)
    ranges = {
        "thickness_m": (0.005, 0.1), "density_kg_m3": (80, 450),
        "specific_surface_area_m2_kg": (5, 60), "temperature_c": (-25, 0),
    }  # fmt: skip
    arrays = {name: rng.uniform(*limits, (6, n_layers)) for name, limits in ranges.items()}
    arrays["thickness_m"][4:, 1] = 0.0
    variables = {name: (("time", "layer"), values) for name, values in arrays.items()}
    for name, values in changes.items():
        dims = ("time", "layer") if np.ndim(values) == 2 else "time"
        variables[name] = (dims, values)
    return xr.Dataset(variables, {"time": TIMES})


def spread(values):
    """Return values over time and three layers."""
    return np.tile(np.asarray(values, float)[:, np.newaxis], 3)


WATER = spread([0.0, 0.0, 0.02, 0.05, 0.02, 0.0])
WATER[2, 0] = 0.0
CASES = {
    "dry": {},
    "soot": {SOOT: spread([0, 10, 50, 100, 500, 5])},
    "wet and dry": {"liquid_water_content": WATER},
    "ground of each": {"ground_albedo": np.linspace(0.0, 0.8, 6)},
    "one layer": {"thickness_m": np.array([[0.05, 0.0, 0.0]] * 6)},
}


def compute_one_by_one(packs, incidence, ground=None):
    return xr.concat(
        [
            splits.spectrophotometer(
                packs.make_stack(time, ground), WAVELENGTHS, angle, solver="discrete_ordinates"
            )
            for time, angle in zip(TIMES, incidence, strict=True)
        ],
        "time",
    )


def get_flags(result):
    names = dict(
        zip(
            result.quality_flag.attrs["flag_values"],
            result.quality_flag.attrs["flag_meanings"].split(),
            strict=True,
        )
    )
    return [names[value] for value in result.quality_flag.values]


@pytest.mark.parametrize("case", CASES)
def test_equals_one_by_one(case):
    packs = splits.SnowPacks(make_dataset(sun_zenith_deg=ZENITH, **CASES[case]))
    if "ground_albedo" not in CASES[case]:
        packs = packs.with_ground(0.2)
    result = splits.spectrophotometer(packs, WAVELENGTHS, "sun")
    assert result.reflectance.dims == ("time", "wavelength")
    assert result.attrs["solver"] == "discrete_ordinates" and result.attrs["streams"] >= 8
    one = splits.spectrophotometer(packs.make_stack(TIMES[0]), WAVELENGTHS, ZENITH[0])
    of_medium = {name for name in one.attrs if not name.startswith("stack_")} - {"seed"}
    assert of_medium <= {*result.attrs}
    expected = compute_one_by_one(packs, ZENITH)
    for name in ("reflectance", "transmittance", "absorptance"):
        np.testing.assert_allclose(result[name], expected[name], rtol=0, atol=1e-6)
        # Errors of small transmittances are absolute, those of one snowpack relative.
        actual, single = (dataset[f"{name}_stderr"].values for dataset in (result, expected))
        assert (actual >= single * (1.0 - 1e-5) - 1e-9).all()
        if name == "reflectance":
            np.testing.assert_allclose(actual, single, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("incidence", [60.0, "diffuse"])
def test_common_incidence_and_open_boundary(incidence):
    packs = splits.SnowPacks(make_dataset())
    result = splits.spectrophotometer(packs, WAVELENGTHS, incidence)
    expected = compute_one_by_one(packs, [incidence] * 6)
    np.testing.assert_allclose(result.reflectance, expected.reflectance, atol=1e-6)
    np.testing.assert_allclose(result.transmittance, expected.transmittance, atol=1e-6)
    assert result.attrs["incidence_deg"] == incidence


def test_incidence_of_each_snowpack_is_matched_by_label():
    packs = splits.SnowPacks(make_dataset())
    by_time = xr.DataArray(ZENITH[::-1], {"time": TIMES[::-1]}, ("time",))
    results = [
        splits.spectrophotometer(packs, WAVELENGTHS, one)
        for one in (ZENITH, by_time, pd.Series(ZENITH, TIMES))
    ]
    for result in results[1:]:
        xr.testing.assert_equal(result, results[0])
    assert results[0].sun_zenith_deg.values.tolist() == ZENITH.tolist()


def test_snowpacks_without_result_have_nan_and_a_flag():
    dataset = make_dataset(liquid_water_content=spread([0, 0, 0, 0.6, 0, 0]))
    dataset["density_kg_m3"][3] = 200.0
    dataset["density_kg_m3"][0, 0] = NAN
    dataset["density_kg_m3"][1] = 2000.0
    dataset["thickness_m"][2] = 0.0
    packs = splits.SnowPacks(dataset)
    result = splits.spectrophotometer(packs, WAVELENGTHS, [30, 30, 30, 30, 90.5, 30])
    expected = ["missing_value", "out_of_range", "no_snow", "unsupported", "night", "good"]
    assert get_flags(result) == expected
    is_nan = result.reflectance.isnull()
    assert is_nan[:5].all() and not is_nan[5].any()
    assert result.reflectance_stderr.isnull()[:5].all()


def test_no_good_snowpack_gives_an_empty_result():
    packs = splits.SnowPacks(make_dataset(sun_zenith_deg=np.full(6, 120.0)))
    result = splits.spectrophotometer(packs, WAVELENGTHS, "sun")
    assert result.reflectance.isnull().all() and get_flags(result) == ["night"] * 6


def test_files_and_flags_of_results(tmp_path):
    packs = splits.SnowPacks(make_dataset(sun_zenith_deg=ZENITH + 3.0), ground=0.1)
    result = splits.spectrophotometer(packs, WAVELENGTHS, "sun")
    splits.save(result, tmp_path / "season.nc")
    read = splits.load(tmp_path / "season.nc")
    xr.testing.assert_equal(read, result)
    assert read.time.values[0] == TIMES[0].to_datetime64()
    assert read.quality_flag.attrs["flag_values"].tolist() == list(RESULT_FLAGS.values())
    assert read.attrs["snow_packs_ground"] == "albedo 0.1"


def test_parts_and_threads_change_nothing(monkeypatch):
    packs = splits.SnowPacks(make_dataset(sun_zenith_deg=ZENITH))
    wavelengths = np.linspace(400, 2000, 20)
    whole = splits.spectrophotometer(packs, wavelengths, "sun", threads=1)
    monkeypatch.setattr(snow_packs, "MAX_ROWS", 3)
    parts = splits.spectrophotometer(packs, wavelengths, "sun", threads=2)
    np.testing.assert_allclose(parts.reflectance, whole.reflectance, rtol=1e-12)


def test_memory_estimate_counts_layers_and_streams():
    assert estimate_bytes(40, 8) > 1.5 * estimate_bytes(20, 8)
    assert estimate_bytes(20, 64) > 20 * estimate_bytes(20, 8)


def test_progress_reports_snowpacks():
    reports = []
    packs = splits.SnowPacks(make_dataset())
    splits.spectrophotometer(packs, WAVELENGTHS, progress=reports.append)
    assert all(isinstance(one, Progress) for one in reports)
    assert str(reports[-1]) == "6 of 6 snowpacks, 0 s left" and reports[-1].fraction_done == 1.0


def test_label_other_than_time():
    dataset = make_dataset().rename(time="site").assign_coords(site=list("abcdef"))
    result = splits.spectrophotometer(splits.SnowPacks(dataset), WAVELENGTHS)
    assert result.reflectance.dims == ("site", "wavelength")
    assert result.site.values.tolist() == list("abcdef")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"solver": "monte_carlo"},
            r"for SnowPacks \(paths are for one snowpack: packs.make_stack",
        ),
        ({"solver": "paths"}, "solver = 'paths': must be one of"),
        ({"incidence_deg": "sun"}, r"with sun_zenith_deg \(packs.with_sun_zenith\(angles\)"),
        ({"incidence_deg": [10, 20]}, "sun_zenith_deg = 'numbers of shape"),
        ({"jacobian": ["depth_m"]}, "jacobian = .* must be left out for SnowPacks"),
        ({"stokes": True}, "stokes = True: must be left out for SnowPacks .polarization needs"),
        ({"estimator": "analog"}, "estimator = 'analog': must be left out for SnowPacks"),
        ({"wavelength_nm": [500, 3100]}, "for discrete ordinates, snow has an index of ice"),
    ],
)
def test_invalid_arguments(arguments, message):
    packs = splits.SnowPacks(make_dataset())
    with pytest.raises(ValueError, match=message):
        splits.spectrophotometer(packs, **{"wavelength_nm": WAVELENGTHS, **arguments})


@pytest.mark.parametrize("measure", [splits.goniophotometer, splits.beam_spread])
def test_other_instruments_name_how_to_take_one_snowpack(measure):
    with pytest.raises(ValueError, match=r"one medium \(packs.make_stack\(label\)"):
        measure(splits.SnowPacks(make_dataset()), WAVELENGTHS)
