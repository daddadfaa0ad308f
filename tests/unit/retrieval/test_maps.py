"""Retrieval maps: agreement with single retrievals, and flags of invalid pixels."""

import dask.array
import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT
from formula_tables import W, evaluate_spectrum, make_snowlike_table, make_table

import splits
from splits.core.validation import InvalidValue
from splits.retrieval.maps import FLAGS

SIZE, SOOT = "optical_radius_um", "impurities_ng_g.black_carbon"
FIXED = {"incidence_deg": 30.0}


@pytest.fixture(scope="module")
def table():
    return make_snowlike_table()


def make_image(sizes, soot_contents, noise=0.01):
    random = np.random.default_rng(3)
    values = np.array([[evaluate_spectrum(size, soot) for soot in soot_contents] for size in sizes])
    values += noise * random.standard_normal(values.shape)
    return xr.DataArray(values, {"wavelength": W, "y": np.arange(len(sizes))},
                        ("y", "x", "wavelength"))  # fmt: skip


@pytest.fixture(scope="module")
def image():
    return make_image(np.geomspace(60.0, 1500.0, 4), [20.0, 200.0, 900.0])


@pytest.mark.long
def test_pixels_match_single_retrievals(table, image):
    result = splits.retrieve_map(image, table, [SIZE, SOOT], 0.01, fixed=FIXED)
    assert result[SIZE].dims == ("y", "x")
    assert not result.quality_flag.any()
    for y in range(image.sizes["y"]):
        for x in range(image.sizes["x"]):
            single = splits.retrieve(image[y, x], table, [SIZE, SOOT], 0.01, fixed=FIXED).dataset
            difference = (
                result[[SIZE, SOOT]].isel(y=y, x=x).to_dataarray().values - single.value.values
            )
            # The principal components of maps omit contributions below 1 % of the noise.
            assert (np.abs(difference) < 0.25 * single.value_stderr.values).all()


def test_invalid_pixels_are_flagged(table, image):
    broken = image.copy()
    broken[0, 0, 2] = np.nan
    broken[1, 1] *= 100.0
    broken[2, 2] = np.linspace(0.1, 0.9, W.size)
    result = splits.retrieve_map(broken, table, [SIZE, SOOT], 0.01, fixed=FIXED)
    assert result.quality_flag[0, 0] == FLAGS["gap"] and np.isnan(result[SIZE][0, 0])
    assert result.quality_flag[1, 1] == FLAGS["out_of_range"] and np.isnan(result[SIZE][1, 1])
    assert result.quality_flag[2, 2].values & FLAGS["poor_fit"]
    valid = result.quality_flag.values == 0
    expected = splits.retrieve_map(image, table, [SIZE, SOOT], 0.01, fixed=FIXED)
    np.testing.assert_array_equal(result[SIZE].values[valid], expected[SIZE].values[valid])


def test_a_dataset_is_no_table(table, image):
    with pytest.raises(InvalidValue, match=r"table = 'Dataset': must be a Table \(splits.Table"):
        splits.retrieve_map(image, table.dataset, [SIZE, SOOT], 0.01, fixed=FIXED)


def test_bounds_and_unconstrained_parameters_are_flagged(table, image):
    sizes = splits.retrieve_map(
        image, table, {SIZE: (400.0, 900.0)}, 0.01, fixed={**FIXED, SOOT: 200.0}
    )
    assert (sizes.quality_flag[0].values & FLAGS["at_lower_bound"]).all()
    assert (sizes.quality_flag[3].values & FLAGS["at_upper_bound"]).all()
    unconstrained = splits.retrieve_map(image[:1, :1], table, [SIZE, "incidence_deg"], 0.01,
                                fixed={SOOT: 20.0})  # fmt: skip
    assert unconstrained.quality_flag.values.item() & FLAGS["unconstrained"]


def test_result_is_independent_of_blocks_and_threads(table, image):
    expected = splits.retrieve_map(image, table, [SIZE, SOOT], 0.01, fixed=FIXED, threads=1)
    lazy = image.copy(data=dask.array.from_array(image.values, chunks=(1, 2, 4)))
    blocks = splits.retrieve_map(lazy, table, [SIZE, SOOT], 0.01, fixed=FIXED, threads=2)
    assert isinstance(blocks[SIZE].data, dask.array.Array)
    xr.testing.assert_equal(blocks.compute(), expected)


@NEEDS_JIT
def test_pixel_errors_match_the_deviations(table):
    """z scores of the logarithm of size and the square root of soot, over 900 pixels."""
    sizes, soot_contents = np.geomspace(80.0, 1200.0, 30), np.linspace(6.0, 36.0, 30) ** 2
    result = splits.retrieve_map(
        make_image(sizes, soot_contents), table, [SIZE, SOOT], 0.01, fixed=FIXED
    )
    z = [
        (np.log(result[SIZE] / sizes[:, np.newaxis]) * result[SIZE]
         / result[f"{SIZE}_stderr"]).values,
        (2.0 * (np.sqrt(result[SOOT]) - np.sqrt(soot_contents)) * np.sqrt(result[SOOT])
         / result[f"{SOOT}_stderr"]).values,
    ]  # fmt: skip
    for scores in z:
        assert np.sqrt((scores**2).mean()) == pytest.approx(1.0, abs=0.1)
        assert abs(scores.mean()) < 0.15


@NEEDS_JIT
def test_maps_converge_like_retrievals_from_zero_amounts():
    """On square-root axes the derivative is zero at 0, where many descents begin."""

    def evaluate_wet_spectrum(size, soot, water):
        return evaluate_spectrum(size, soot) * np.exp(-2.0 * water * ((W - 500.0) / 1000.0) ** 2)

    table = make_table(
        evaluate_wet_spectrum,
        {
            SIZE: np.geomspace(40.0, 2000.0, 9), SOOT: np.linspace(0.0, 40.0, 6) ** 2,
            "water": np.linspace(0.0, 0.55, 5) ** 2,
        },
    )  # fmt: skip
    random = np.random.default_rng(8)
    free = [SIZE, SOOT, "water"]
    values = np.array([
        evaluate_wet_spectrum(np.exp(a), b**2, c**2) + 0.005 * random.standard_normal(W.size)
        for a, b, c in zip(np.log(50.0) + 3.4 * random.random(60), 38.0 * random.random(60),
                           0.5 * random.random(60), strict=True)
    ])  # fmt: skip
    image = xr.DataArray(values, {"wavelength": W}, ("x", "wavelength"))
    result = splits.retrieve_map(image, table, free, 0.005)
    n_worse = 0
    for x in range(image.sizes["x"]):
        single = splits.retrieve(image[x], table, free, 0.005).dataset.attrs
        n_worse += float(result.chi2[x]) > single["chi2"] + 4.0
    assert n_worse <= 1
    # The descent may converge slowly for an unconstrained parameter, which is flagged.
    assert ((result.quality_flag.values & FLAGS["not_converged"]) > 0).mean() < 0.05


def to_band_image(image):
    """Return an image over named bands with a wavelength coordinate, as raster readers do."""
    bands = image.rename(wavelength="band")
    band_names = [f"B{number}" for number in range(W.size)]
    return bands.assign_coords(band=band_names, wavelength=("band", W)).transpose("band", ...)


@pytest.mark.parametrize(
    "change",
    [to_band_image, lambda image: to_band_image(image).drop_vars("band")],
    ids=["bands by name", "bands alone"],
)
def test_band_images_equal_wavelength_images(table, image, change):
    expected = splits.retrieve_map(image, table, [SIZE, SOOT], 0.01, fixed=FIXED)
    result = splits.retrieve_map(change(image), table, [SIZE, SOOT], 0.01, fixed=FIXED)
    xr.testing.assert_equal(result, expected)


def test_stacked_pixels_give_the_same_result(table, image):
    image = image.assign_coords(x=[1.0, 2.0, 3.0])
    expected = splits.retrieve_map(image, table, [SIZE, SOOT], 0.01, fixed=FIXED)
    stacked = image.stack(pixel=("y", "x"))
    result = splits.retrieve_map(stacked, table, [SIZE, SOOT], 0.01, fixed=FIXED)
    xr.testing.assert_allclose(result.unstack("pixel"), expected, rtol=1e-12)


TWO_PIXELS = xr.DataArray(np.full((2, W.size), 0.5), {}, ("x", "band"))
INVALID_CALLS = {
    "bands without wavelengths": (
        {"image": TWO_PIXELS},
        r"over x, band.*assign_coords\(wavelength=",
    ),
    "wavelengths by pixel": (
        {"image": TWO_PIXELS.assign_coords(wavelength=(("x", "band"), np.tile(W, (2, 1))))},
        "over x, band",
    ),
    "one wavelength": (
        {"image": TWO_PIXELS.isel(band=0).assign_coords(wavelength=500.0)},
        "image = 'over x'",
    ),
    "named like a result": (
        {"image": TWO_PIXELS.rename(x=SIZE).assign_coords(wavelength=("band", W))},
        f"image = 'with {SIZE}': must be without names that results have",
    ),
    "no pixel": (
        {"image": xr.DataArray(np.zeros((0, W.size)), {"wavelength": W}, ("x", "wavelength"))},
        "no pixel",
    ),
    "no image": ({"image": np.zeros((2, 2, W.size))}, "a DataArray over wavelength"),
    "scale": ({"free": [SIZE, "scale"]}, "left out of maps"),
    "no noise": ({"noise": 0.0}, "no measurement is without noise"),
    "unknown noise": ({"noise": None}, "noise = None: must be given"),
}


@pytest.mark.parametrize("name", INVALID_CALLS)
def test_invalid_input_is_rejected(table, image, name):
    changes, message = INVALID_CALLS[name]
    valid = {
        "image": image,
        "table": table,
        "free": [SIZE],
        "noise": 0.01,
        "fixed": {**FIXED, SOOT: 9.0},
    }
    with pytest.raises(InvalidValue, match=message):
        splits.retrieve_map(**(valid | changes))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda one: 100.0 * one, r"image = 'of the median .*neither per cent nor digital numbers"),
        (lambda one: (1e4 * one).astype("int16"), r"image = 'of the median .*divide the image"),
        (lambda one: (100.0 * one).where(one.x > 0), "image = 'of the median"),
        (lambda one: one.where(one.wavelength != W[3]), "without a number at 800 nm.*leave it"),
        (lambda one: one.assign_attrs(units="DN"), "image.units = 'DN': must be one of 1, "),
        (lambda one: one.assign_coords(incidence_deg=60.0), "image.incidence_deg = .*must be 30.0"),
        (lambda one: one.assign_coords(incidence_deg=("x", [30.0, 30.0, 31.0])), "parts with"),
        (lambda one: one.assign_coords(wavelength=("wavelength", one.wavelength.values,
                                                   {"units": "um"})), "wavelength.units = 'um'"),
    ],
)  # fmt: skip
def test_images_without_a_valid_pixel_are_refused(table, image, change, message):
    image = image.assign_coords(x=[0, 1, 2])
    with pytest.raises(InvalidValue, match=message) as error:
        splits.retrieve_map(change(image), table, [SIZE], 0.01, fixed={**FIXED, SOOT: 9.0})
    assert "\n" not in str(error.value)


def test_pixels_outside_of_a_scene_do_not_hide_its_scale(table, image):
    numbers = 10_000.0 * image
    numbers[{"x": 0}] = 0.0
    with pytest.raises(InvalidValue, match="divide the image by its scale"):
        splits.retrieve_map(numbers, table, [SIZE], 0.01, fixed={**FIXED, SOOT: 9.0})


def test_blocks_without_a_valid_pixel_give_a_warning(table, image):
    pytest.importorskip("dask")
    lazy = xr.concat([image, 100.0 * image], "x").chunk(x=3)
    result = splits.retrieve_map(lazy, table, [SIZE], 0.01, fixed={**FIXED, SOOT: 9.0})
    with pytest.warns(UserWarning, match="a block of the image has no result: image = 'of the med"):
        assert (result.quality_flag.values[..., 3:] == FLAGS["out_of_range"]).all()


def test_images_may_be_in_per_cent_and_in_any_order(table, image):
    noise = np.linspace(0.01, 0.02, W.size)
    keywords = {"table": table, "free": [SIZE], "fixed": {**FIXED, SOOT: 9.0}}
    expected = splits.retrieve_map(image, noise=noise, **keywords)
    per_cent = (100.0 * image).assign_attrs(units="%")
    for one in (per_cent, per_cent.assign_coords(incidence_deg=np.float32(30.0))):
        found = splits.retrieve_map(one, noise=noise, **keywords)
        xr.testing.assert_allclose(found.drop_vars("incidence_deg", errors="ignore"), expected)
    backwards = image.isel(wavelength=slice(None, None, -1))
    xr.testing.assert_equal(splits.retrieve_map(backwards, noise=noise[::-1], **keywords), expected)


@pytest.mark.long
def test_errors_of_poor_fits_are_those_of_single_retrievals(table):
    """Errors are increased with and without a prior; without a misfit, both agree as well."""
    spectrum = evaluate_spectrum(200.0, 50.0)
    ripples = np.array([0.0, 0.02, 0.05])[:, np.newaxis] * (-1.0) ** np.arange(W.size)
    image = xr.DataArray(spectrum + ripples, {"wavelength": W}, ("x", "wavelength"))
    for prior in ({}, {SOOT: (50.0, 10.0)}):
        keywords = {"fixed": FIXED, "prior": prior}
        found = splits.retrieve_map(image, table, [SIZE, SOOT], 0.01, **keywords)
        assert ((found.quality_flag.values & FLAGS["poor_fit"]) > 0).tolist() == [False, True, True]
        for x in range(3):
            single = splits.retrieve(image[x], table, [SIZE, SOOT], 0.01, **keywords).dataset
            assert (single.attrs["error_inflation"] > 1.0) == (x > 0)
            stderr = [found[f"{name}_stderr"].values[x] for name in (SIZE, SOOT)]
            np.testing.assert_allclose(stderr, single.value_stderr, rtol=0.25)
