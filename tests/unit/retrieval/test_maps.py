"""Maps: every pixel as in a single retrieval, and flags of invalid ones."""

from __future__ import annotations

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


def make_image(sizes, dirts, noise=0.01):
    random = np.random.default_rng(3)
    values = np.array([[evaluate_spectrum(size, dirt) for dirt in dirts] for size in sizes])
    values += noise * random.standard_normal(values.shape)
    return xr.DataArray(values, {"wavelength": W, "y": np.arange(len(sizes))},
                        ("y", "x", "wavelength"))  # fmt: skip


@pytest.fixture(scope="module")
def image():
    return make_image(np.geomspace(60.0, 1500.0, 4), [20.0, 200.0, 900.0])


def test_pixels_are_as_retrieved_alone(table, image):
    found = splits.retrieve_map(image, table, [SIZE, SOOT], 0.01, fixed=FIXED)
    assert found[SIZE].dims == ("y", "x")
    assert not found.flags.any()
    for y in range(image.sizes["y"]):
        for x in range(image.sizes["x"]):
            alone = splits.retrieve(image[y, x], table, [SIZE, SOOT], 0.01, fixed=FIXED).dataset
            off = found[[SIZE, SOOT]].isel(y=y, x=x).to_dataarray().values - alone.value.values
            # The map's components leave out what tells less than a hundredth of the noise.
            assert (np.abs(off) < 0.25 * alone.value_stderr.values).all()


def test_bad_pixels_are_flagged(table, image):
    broken = image.copy()
    broken[0, 0, 2] = np.nan
    broken[1, 1] *= 100.0
    broken[2, 2] = np.linspace(0.1, 0.9, W.size)
    found = splits.retrieve_map(broken, table, [SIZE, SOOT], 0.01, fixed=FIXED)
    assert found.flags[0, 0] == FLAGS["gap"] and np.isnan(found[SIZE][0, 0])
    assert found.flags[1, 1] == FLAGS["out_of_range"] and np.isnan(found[SIZE][1, 1])
    assert found.flags[2, 2].values & FLAGS["poor_fit"]
    fine = found.flags.values == 0
    plain = splits.retrieve_map(image, table, [SIZE, SOOT], 0.01, fixed=FIXED)
    np.testing.assert_array_equal(found[SIZE].values[fine], plain[SIZE].values[fine])


def test_ends_of_ranges_and_unconstrained_parameters_are_flagged(table, image):
    low = splits.retrieve_map(
        image, table, {SIZE: (400.0, 900.0)}, 0.01, fixed={**FIXED, SOOT: 200.0}
    )
    assert (low.flags[0].values & FLAGS["at_lower_bound"]).all()
    assert (low.flags[3].values & FLAGS["at_upper_bound"]).all()
    angle = splits.retrieve_map(image[:1, :1], table, [SIZE, "incidence_deg"], 0.01,
                                fixed={SOOT: 20.0})  # fmt: skip
    assert angle.flags.values.item() & FLAGS["unconstrained"]


def test_blocks_and_threads_do_not_matter(table, image):
    whole = splits.retrieve_map(image, table, [SIZE, SOOT], 0.01, fixed=FIXED, threads=1)
    lazy = image.copy(data=dask.array.from_array(image.values, chunks=(1, 2, 4)))
    blocks = splits.retrieve_map(lazy, table, [SIZE, SOOT], 0.01, fixed=FIXED, threads=2)
    assert isinstance(blocks[SIZE].data, dask.array.Array)
    xr.testing.assert_equal(blocks.compute(), whole)


@NEEDS_JIT
def test_errors_of_pixels(table):
    """z of the logarithm of size and the root of dirt, over 900 pixels."""
    sizes, dirts = np.geomspace(80.0, 1200.0, 30), np.linspace(6.0, 36.0, 30) ** 2
    found = splits.retrieve_map(make_image(sizes, dirts), table, [SIZE, SOOT], 0.01, fixed=FIXED)
    z = [
        (np.log(found[SIZE] / sizes[:, np.newaxis]) * found[SIZE] / found[f"{SIZE}_stderr"]).values,
        (2.0 * (np.sqrt(found[SOOT]) - np.sqrt(dirts)) * np.sqrt(found[SOOT])
         / found[f"{SOOT}_stderr"]).values,
    ]  # fmt: skip
    for one in z:
        assert np.sqrt((one**2).mean()) == pytest.approx(1.0, abs=0.1)
        assert abs(one.mean()) < 0.15


@NEEDS_JIT
def test_maps_end_where_retrievals_do_where_amounts_begin_with_none():
    """On axes that are roots light has no slope at 0, where many descents begin."""

    def wet(size, dirt, water):
        return evaluate_spectrum(size, dirt) * np.exp(-2.0 * water * ((W - 500.0) / 1000.0) ** 2)

    table = make_table(
        wet,
        {
            SIZE: np.geomspace(40.0, 2000.0, 9), SOOT: np.linspace(0.0, 40.0, 6) ** 2,
            "water": np.linspace(0.0, 0.55, 5) ** 2,
        },
    )  # fmt: skip
    random = np.random.default_rng(8)
    free = [SIZE, SOOT, "water"]
    values = np.array([
        wet(np.exp(a), b**2, c**2) + 0.005 * random.standard_normal(W.size)
        for a, b, c in zip(np.log(50.0) + 3.4 * random.random(60), 38.0 * random.random(60),
                           0.5 * random.random(60), strict=True)
    ])  # fmt: skip
    image = xr.DataArray(values, {"wavelength": W}, ("x", "wavelength"))
    found = splits.retrieve_map(image, table, free, 0.005)
    worse = 0
    for x in range(image.sizes["x"]):
        alone = splits.retrieve(image[x], table, free, 0.005).dataset.attrs
        worse += float(found.chi2[x]) > alone["chi2"] + 4.0
    assert worse <= 1
    # Where nothing tells a parameter a descent may creep for long, which is flagged.
    assert ((found.flags.values & FLAGS["not_converged"]) > 0).mean() < 0.05


def to_band_image(image):
    """Return an image as readers of rasters have it: over bands, of which wavelengths are told."""
    bands = image.rename(wavelength="band")
    names = [f"B{number}" for number in range(W.size)]
    return bands.assign_coords(band=names, wavelength=("band", W)).transpose("band", ...)


@pytest.mark.parametrize(
    "change",
    [to_band_image, lambda image: to_band_image(image).drop_vars("band")],
    ids=["bands by name", "bands alone"],
)
def test_an_image_over_bands_is_one_over_their_wavelengths(table, image, change):
    plain = splits.retrieve_map(image, table, [SIZE, SOOT], 0.01, fixed=FIXED)
    found = splits.retrieve_map(change(image), table, [SIZE, SOOT], 0.01, fixed=FIXED)
    xr.testing.assert_equal(found, plain)


def test_stacked_pixels_are_unstacked_to_the_same(table, image):
    image = image.assign_coords(x=[1.0, 2.0, 3.0])
    plain = splits.retrieve_map(image, table, [SIZE, SOOT], 0.01, fixed=FIXED)
    stacked = image.stack(pixel=("y", "x"))
    found = splits.retrieve_map(stacked, table, [SIZE, SOOT], 0.01, fixed=FIXED)
    xr.testing.assert_allclose(found.unstack("pixel"), plain, rtol=1e-12)


WARNING_LINES = xr.DataArray(np.full((2, W.size), 0.5), {}, ("x", "band"))
INVALID_CALLS = {
    "bands without wavelengths": (
        {"image": WARNING_LINES},
        r"over x, band.*assign_coords\(wavelength=",
    ),
    "wavelengths by pixel": (
        {"image": WARNING_LINES.assign_coords(wavelength=(("x", "band"), np.tile(W, (2, 1))))},
        "over x, band",
    ),
    "one wavelength": (
        {"image": WARNING_LINES.isel(band=0).assign_coords(wavelength=500.0)},
        "image = 'over x'",
    ),
    "named like a result": (
        {"image": WARNING_LINES.rename(x=SIZE).assign_coords(wavelength=("band", W))},
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
def test_bad_input_is_rejected(table, image, name):
    other, message = INVALID_CALLS[name]
    given = {
        "image": image,
        "table": table,
        "free": [SIZE],
        "noise": 0.01,
        "fixed": {**FIXED, SOOT: 9.0},
    }
    with pytest.raises(InvalidValue, match=message):
        splits.retrieve_map(**(given | other))
