"""Bands of maps, tables and reflectance factors: labels, limits, weights and messages."""

import dask.array
import numpy as np
import pytest
import xarray as xr
from formula_tables import evaluate_spectrum, make_snowlike_table, make_table

import splits
from splits.core.validation import InvalidValue
from splits.illumination.bands import SpectralOperator, as_bands, choose_band_wavelengths

SIZE, SOOT = "optical_radius_um", "impurities_ng_g.black_carbon"
FIXED = {"incidence_deg": 30.0, SOOT: 20.0}
BANDS = {"c": (520, 560), "a": (800, 930), "b": (1010, 1080)}
NAMES = list(BANDS)
ONE = {"threads": 1}
GREY = splits.ParticleLayer(single_scattering_albedo=0.9, asymmetry=0.6, optical_thickness=2.0)
SKY = {"wavelength_nm": [400, 700, 1200], "direct": [1.0, 3.0, 0.5], "diffuse": [2.0, 0.5, 0.1]}


@pytest.fixture(scope="module")
def table():
    return make_snowlike_table()


def average(band, evaluate):
    """Return the mean of a function of the wavelength over a band."""
    fine = np.linspace(*band.limits_nm, 20_001)
    response = np.interp(fine, band.wavelength_nm, band.response)
    return np.trapezoid(response * evaluate(fine), fine) / np.trapezoid(response, fine)


@pytest.fixture(scope="module")
def image(table):
    sizes = np.geomspace(80.0, 900.0, 12).reshape(3, 4)
    values = [
        table.interp(**FIXED, optical_radius_um=size, bands=BANDS).band_reflectance.values
        for size in sizes.flat
    ]
    values = np.reshape(values, (*sizes.shape, -1))
    return xr.DataArray(values, {"band": NAMES, "size": (("y", "x"), sizes)}, ("y", "x", "band"))


def retrieve_map(image, table, noise=0.01, bands=BANDS, **options):
    return splits.retrieve_map(
        image, table, [SIZE], noise, fixed=FIXED, bands=bands, **ONE, **options
    )


# --- maps -----------------------------------------------------------------------------------------


def test_maps_have_the_sizes_of_their_bands(image, table):
    found = retrieve_map(image, table)
    np.testing.assert_allclose(found[SIZE], image["size"], rtol=1e-3)
    assert not found.quality_flag.any()


def test_the_order_of_labelled_bands_does_not_matter(image, table):
    noise = xr.DataArray([0.002, 0.01, 0.03], {"band": NAMES}, ("band",))
    expected = retrieve_map(image, table, noise)
    for order in ([2, 0, 1], [1, 2, 0]):
        shuffled = image.isel(band=order)
        xr.testing.assert_identical(
            retrieve_map(shuffled, table, noise).drop_attrs(), expected.drop_attrs()
        )
        xr.testing.assert_identical(
            retrieve_map(shuffled.transpose("band", "x", "y"), table, noise[order])
            .transpose("y", "x").drop_attrs(), expected.drop_attrs(),
        )  # fmt: skip
    by_position = retrieve_map(image.drop_vars("band"), table, noise.values)
    xr.testing.assert_identical(by_position.drop_attrs(), expected.drop_attrs())


def test_maps_in_bands_are_processed_by_blocks(image, table):
    lazy = image.copy(data=dask.array.from_array(image.values, chunks=(2, 3, 1)))
    found = retrieve_map(lazy, table)
    assert isinstance(found[SIZE].data, dask.array.Array)
    xr.testing.assert_identical(
        found.compute().drop_attrs(), retrieve_map(image, table).drop_attrs()
    )


def test_wavelengths_of_bands_may_be_given_within_them(image, table):
    named = image.assign_coords(wavelength=("band", [540.0, 865.0, 1045.0]))
    assert retrieve_map(named, table)[SIZE].equals(retrieve_map(image, table)[SIZE])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.assign_coords(band=["c", "a", "d"]), r"image.band = .*\['c', 'a', 'b'\]"),
        (lambda a: a.assign_coords(band=[1, 2, 3]), r"image.band = 'values at \[1, 2, 3\]'"),
        (lambda a: a.isel(band=[0, 1]), "image = '2 bands': must be over 3, as many as in bands"),
        (lambda a: a.rename(band="wavelength"), "must be a DataArray over band and others"),
        (lambda a: a.values, "image = 'ndarray': must be a DataArray over band"),
        (lambda a: a.assign_coords(wavelength=("band", [865.0, 540.0, 1045.0])),
         "image.wavelength = 865.0: must be within .*520 to 560 nm.* of c"),
        (lambda a: a.isel(y=[]), "image = 'no pixel'"),
    ],
)  # fmt: skip
def test_images_of_other_bands_are_refused(image, table, change, message):
    with pytest.raises(InvalidValue, match=message) as error:
        retrieve_map(change(image), table)
    assert "\n" not in str(error.value)


# --- all four -------------------------------------------------------------------------------------


def build(**options):
    return splits.build_table(lambda optical_radius_um: GREY, {SIZE: [50, 100]}, max_stderr=0.02,
                              **ONE, **options).dataset  # fmt: skip


@pytest.mark.parametrize(
    ("bands", "message"),
    [({}, "bands = {}: must be at least one band"), ("sentinel", "bands = 'sentinel': must be one"),
     ({"a": (600, 500)}, r"bands.a = \(600, 500\): must be 0 < low < high"),
     ([(500, 600)], "bands = .*: must be a mapping of names to bands")],
)  # fmt: skip
def test_bands_are_checked_alike(image, table, bands, message):
    for call in (
        lambda: retrieve_map(image, table, bands=bands),
        lambda: table.interp(**FIXED, optical_radius_um=100, bands=bands),
        lambda: build(bands=bands),
        lambda: splits.hdrf(GREY, splits.sky(SKY, 50.0), bands=bands, **ONE),
    ):
        with pytest.raises(InvalidValue, match=message) as error:
            call()
        assert "\n" not in str(error.value)


def test_bands_beyond_the_wavelengths_are_refused(image, table):
    bands = {"c": (450, 560), "a": (800, 930), "b": (1010, 1080)}
    for call in (
        lambda: retrieve_map(image, table, bands=bands),
        lambda: table.interp(**FIXED, optical_radius_um=100, bands=bands),
        lambda: build(wavelength_nm=[500, 1500], bands=bands),
    ):
        with pytest.raises(InvalidValue, match=r"bands\['c'\] = \[450.0, 560.0\]: must be within"):
            call()
    with pytest.raises(InvalidValue, match=r"bands.far = .*: must be bands with light between"):
        splits.hdrf(GREY, splits.sky(SKY, 50.0), bands={"far": (3000, 3100)}, **ONE)


# --- tables ---------------------------------------------------------------------------------------


def test_interpolated_means_contain_the_whole_spectrum(table):
    found = table.interp(**FIXED, optical_radius_um=150, wavelength=[600.0], bands=BANDS)
    assert found.wavelength.values == [600.0] and found.band.values.tolist() == NAMES
    for name in ("", "_stderr", "_interpolation_error"):
        assert found[f"band_reflectance{name}"].dims == ("band",)
    for name, band in as_bands(BANDS).items():
        exact = average(band, lambda w: evaluate_spectrum(150.0, 20.0, w))
        one = found.sel(band=name)
        assert abs(one.band_reflectance - exact) < 3.0 * one.band_reflectance_stderr
    assert (found.band_reflectance_stderr >= found.band_reflectance_interpolation_error).all()


def test_tables_with_means_are_tables(tmp_path):
    made = build(bands=BANDS, covariance=True)
    assert made.band_reflectance.dims == (SIZE, "band")
    assert (made.band_reflectance_stderr <= 0.021).all()
    plain = splits.Table(made.drop_vars(["band_reflectance", "band_reflectance_stderr", "band"]))
    splits.save(made, tmp_path / "table.nc")
    for table in (splits.Table(made), splits.Table(tmp_path / "table.nc")):
        assert table.axes == [SIZE, "wavelength"] and table.quantities == ["reflectance"]
        found = table.interp(optical_radius_um=70, bands=BANDS)
        xr.testing.assert_equal(found, plain.interp(optical_radius_um=70, bands=BANDS))


def test_means_of_directions_are_interpolated():
    made = splits.build_table(
        lambda optical_radius_um: splits.Snow.natural(optical_radius_um=optical_radius_um),
        {SIZE: [80, 160, 320], "polar_deg": [0, 20, 40], "azimuth_deg": [0, 90, 180]},
        incidence_deg=30.0, bands=BANDS, max_stderr=0.01, **ONE,
    ).dataset  # fmt: skip
    assert made.band_reflectance_factor.dims == (SIZE, "polar_deg", "azimuth_deg", "band")
    table = splits.Table(made)
    found = table.interp(optical_radius_um=160, polar_deg=20, azimuth_deg=90, bands=BANDS)
    node = made.band_reflectance_factor.sel({SIZE: 160, "polar_deg": 20, "azimuth_deg": 90})
    np.testing.assert_allclose(found.band_reflectance_factor, node, rtol=1e-5)


@pytest.mark.parametrize("seed", range(40))
def test_errors_of_means_cover_curved_spectra(seed):
    """Spectra of random smooth shapes, wavelengths of random steps, bands of random widths."""
    random = np.random.default_rng(seed)
    step = random.uniform(5.0, 40.0)
    wavelengths = np.arange(400.0, 1500.0, step) + random.uniform(-0.2, 0.2) * step
    lows = random.uniform(450.0, 1200.0, 12)
    limits = np.stack([lows, lows + random.uniform(0.5, 6.0, 12) * step], axis=1)
    bands = as_bands({str(i): tuple(row) for i, row in enumerate(limits)})
    waves = random.uniform(120.0, 600.0, 5), random.uniform(0.0, 6.0, 5)

    def evaluate(w):
        return 0.5 + 0.05 * np.sin(2.0 * np.pi * w[:, np.newaxis] / waves[0] + waves[1]).sum(axis=1)

    matrix = SpectralOperator.from_bands(bands, wavelengths)
    np.testing.assert_allclose(matrix.weights.sum(axis=1), 1.0)
    np.testing.assert_allclose(matrix.error_weights.sum(axis=2), 0.0, atol=1e-12)
    spectrum = evaluate(wavelengths)
    exact = np.array([average(band, evaluate) for band in bands.values()])
    stated = np.sqrt(((matrix.error_weights @ spectrum) ** 2).sum(axis=0) + 1e-6**2)
    z = (matrix.weights @ spectrum - exact) / stated
    assert np.sqrt(np.mean(z**2)) < 1.2 and np.abs(z).max() < 4.0


@pytest.mark.parametrize("seed", range(20))
def test_wavelengths_of_bands_cover_them_without_the_gaps(seed):
    random = np.random.default_rng(seed)
    lows = random.uniform(400.0, 2000.0, random.integers(1, 9))
    bands = as_bands(
        {str(i): (low, low + random.uniform(1.0, 150.0)) for i, low in enumerate(lows)}
    )
    found = choose_band_wavelengths(bands)
    inside = np.zeros(found.size, dtype=bool)
    between = np.zeros(found.size - 1, dtype=bool)
    for low, high in (band.limits_nm for band in bands.values()):
        inside |= (found >= low) & (found <= high)
        between |= (found[1:] > low) & (found[:-1] < high)
        assert found[0] <= low and found[-1] >= high
    assert inside.all() and np.diff(found)[between].max() <= 5.0 + 1e-9


# --- reflectance factors under a sky --------------------------------------------------------------


def test_reflectance_factors_are_weighted_by_irradiance():
    sky, directions = splits.sky(SKY, 50.0), {"polar_deg": [0, 40], "azimuth_deg": [0, 180]}
    medium = splits.Snow.natural(optical_radius_um=150)
    wavelengths = np.arange(450.0, 1151.0, 20.0)
    found = splits.hdrf(medium, sky, wavelengths, bands=BANDS, **directions, **ONE)
    plain = splits.hdrf(medium, sky, wavelengths, **directions, **ONE)
    assert found.band_reflectance_factor.dims == ("band", "polar_deg", "azimuth_deg")
    assert found.reflectance_factor.equals(plain.reflectance_factor) and "band" not in plain
    for name, band in as_bands(BANDS).items():
        weights = sky.compute_weights(wavelengths, band)
        weights = weights / weights.sum()
        expected = np.tensordot(weights, plain.reflectance_factor, 1)
        np.testing.assert_allclose(
            found.band_reflectance_factor.sel(band=name), expected, rtol=1e-12
        )
        # The error of a mean also contains that of interpolation between wavelengths.
        least = np.tensordot(weights, plain.reflectance_factor_stderr, 1)
        stderr = found.band_reflectance_factor_stderr.sel(band=name)
        assert (least <= stderr).all() and (stderr < 0.005).all()
    np.testing.assert_allclose(found.irradiance_covered, 1.0)
    albedo = splits.albedo(medium, sky, wavelengths, bands=BANDS, **ONE)
    assert (albedo.irradiance_covered.sel(band=NAMES) == found.irradiance_covered).all()


def test_wavelengths_under_a_sky_are_those_of_the_bands():
    sky, medium = splits.sky(SKY, 50.0), splits.Snow.natural(optical_radius_um=150)
    bands = {"cut": (350, 420), "near": (800, 820)}
    found = splits.hdrf(medium, sky, bands=bands, polar_deg=[0], azimuth_deg=[0], **ONE)
    np.testing.assert_allclose(found.wavelength, [400, 405, 410, 415, 420, *range(800, 821, 5)])
    assert found.irradiance_covered.values[1] == pytest.approx(1.0)
    with pytest.raises(InvalidValue, match="wavelength_nm = None: must be given, or bands"):
        splits.hdrf(medium, sky, **ONE)
    with pytest.raises(InvalidValue, match="must be at least 2 wavelengths"):
        splits.hdrf(medium, sky, [810], bands=bands, **ONE)


def test_bands_are_retrieved_from_coarse_tables_with_larger_errors():
    """The error of a size contains that of interpolation between wavelengths."""
    errors = []
    for w in (np.arange(500.0, 1501.0, 10.0), np.arange(500.0, 1501.0, 100.0)):
        table = make_table(
            lambda size, w=w: evaluate_spectrum(size, 20.0, w),
            {SIZE: np.geomspace(50, 1500, 16)},
            w=w,
        )
        exact = [average(band, lambda w: evaluate_spectrum(300.0, 20.0, w))
                 for band in as_bands(BANDS).values()]  # fmt: skip
        found = splits.retrieve(exact, table, [SIZE], 0.001, bands=BANDS).dataset
        errors.append(found.value_stderr.item())
        assert abs(found.value.item() - 300.0) < 2.0 * errors[-1]
    assert errors[1] > 1.2 * errors[0]
