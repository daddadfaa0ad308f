"""Results of all public functions are saved, and loaded to the same values."""

import dask.array
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from chi2 import NEEDS_JIT
from formula_tables import W, evaluate_spectrum, make_snowlike_table

import splits
from splits.core.validation import InvalidValue
from splits.retrieval.maps import FLAGS

SIZE, SOOT = "optical_radius_um", "impurities_ng_g.black_carbon"
FREE_PARAMETERS, FIXED = [SIZE, SOOT], {"incidence_deg": 30.0}
PAIR = [500.0, 1030.0]
SKY = "midlatitude_winter"
BANDS = {"visible": (500, 1000)}
MEASURED = (W, evaluate_spectrum(150.0, 50.0))


def make_snow(**changes):
    return splits.Snow.natural(optical_radius_um=100, depth_m=0.02, **changes)


def make_layer(**changes):
    return splits.ParticleLayer(optical_thickness=1.0, **changes)


def make_rough_layer():
    surface = {"rms_height_m": 0.01, "wave_number_per_m": 2, "correlation": "gaussian"}
    return make_layer(surface=surface)


def make_several_media():
    return {"clean": make_snow(), "dirty": make_snow(impurities_ng_g={"black_carbon": 50})}


def compute_grain_optics():
    return splits.single_scattering(make_snow(), PAIR, moments=8, rays=100)


def make_point(**more):
    return {SIZE: 120.0, SOOT: 30.0, "incidence_deg": 20.0, **more}


def make_snow_packs():
    columns = {"thickness_m": [0.2, 0.3], "density_kg_m3": [200, None], SIZE: [100, 200]}
    table = pd.DataFrame({"time": ["a", "b"], "layer": 0, **columns, "sun_zenith_deg": 50.0})
    return splits.SnowPacks(table, ground=0.2)


def build_small_table(**keywords):
    def make_medium(black_carbon, ground):
        return make_snow(impurities_ng_g={"black_carbon": black_carbon}, ground=ground)

    grid = {"black_carbon": [0, 50], "ground": ["black", "open"], "incidence_deg": [0, 60]}
    return splits.build_table(make_medium, grid, PAIR, max_stderr=0.1, **keywords).dataset


def make_return_table():
    """Return a table of the returns of snow of three grain sizes."""
    delays = [0.0, 1e-10, 2e-10, 1e-9]
    grid = {"optical_radius_um": [50.0, 100.0, 200.0]}
    return splits.build_table(splits.Snow.natural, grid, 1030.0, rays=1000, delay_s=delays).dataset


def make_image():
    """Return an image of four pixels, one of which has a gap."""
    values = np.array(
        [[evaluate_spectrum(size, dirt) for dirt in (20.0, 200.0)] for size in (60.0, 900.0)]
    )
    values[0, 1, 3] = np.nan
    axes = {"wavelength": ("band", W), "y": [10.0, 20.0], "x": [1.0, 2.0]}
    return xr.DataArray(values, axes, ("y", "x", "band"))


ORDINATES = {"solver": "discrete_ordinates"}

RESULTS = {
    "SnowPacks": lambda: make_snow_packs().dataset,
    "spectrophotometer of snowpacks": lambda: splits.spectrophotometer(
        make_snow_packs(), PAIR, "sun"
    ),
    "albedo of snowpacks": lambda: splits.albedo(make_snow_packs(), SKY, [500, 800]),
    "spectrophotometer, ordinates": lambda: splits.spectrophotometer(
        make_snow(), PAIR, jacobian=[SIZE, SOOT], **ORDINATES
    ),
    "goniophotometer, ordinates": lambda: splits.goniophotometer(
        make_snow(), PAIR, 30.0, **ORDINATES
    ),
    "irradiance_profile, ordinates": lambda: splits.irradiance_profile(
        make_snow(), PAIR, depth_m=[0.01], **ORDINATES
    ),
    "build_table, ordinates": lambda: (
        splits.build_table(splits.Snow.natural, {SIZE: [100.0, 200.0]}, PAIR, **ORDINATES).dataset
    ),
    "spectrophotometer": lambda: splits.spectrophotometer(make_layer(), PAIR, max_stderr=0.1),
    "spectrophotometer, derivatives": lambda: splits.spectrophotometer(
        make_layer(), PAIR, max_stderr=0.1, jacobian=["single_scattering_albedo"]
    ),
    "spectrophotometer, several": lambda: splits.spectrophotometer(
        make_several_media(), PAIR, max_stderr=0.1
    ),
    "goniophotometer": lambda: splits.goniophotometer(
        make_layer(), PAIR, 30.0, relative_stderr=0.5
    ),
    "beam_spread": lambda: splits.beam_spread(make_layer(), PAIR, rays=1000, half_width_m=1.0),
    "time_of_flight": lambda: splits.time_of_flight(make_snow(), PAIR, rays=1000, depth_m=[0.01]),
    "time_of_flight of infinite depth": lambda: splits.time_of_flight(
        splits.Snow.natural(optical_radius_um=100, depth_m=float("inf")),
        PAIR,
        rays=1000,
        delay_s=[0.0, 1e-10],
    ),
    "irradiance_profile": lambda: splits.irradiance_profile(
        make_snow(), PAIR, depth_m=[0.01], max_stderr=0.1
    ),
    "lens": lambda: splits.lens(
        make_rough_layer(), screen_depth_m=[1.0], radius_m=0.1, centre_on="origin", rays=1000
    ),
    "surface_map": lambda: splits.surface_map(
        make_rough_layer(), half_width_m=1.0, points=5, realizations=2
    ),
    "single_scattering": compute_grain_optics,
    "compute_mie_matrix": lambda: splits.compute_mie_matrix(PAIR, "water", 0.1, 0.1),
    "with_diffraction": lambda: splits.with_diffraction(compute_grain_optics()),
    "phase_function": lambda: splits.phase_function(compute_grain_optics(), [0, 90, 180]),
    "build_table": build_small_table,
    "build_table, covariance": lambda: build_small_table(covariance=True),
    "build_table, returns": make_return_table,
    "Table": lambda: make_snowlike_table().dataset,
    "Table.interp": lambda: make_snowlike_table().interp(**make_point()),
    "Table.derivatives": lambda: make_snowlike_table().derivatives(FREE_PARAMETERS, **make_point()),
    "Table.to_isofit": lambda: make_snowlike_table().to_isofit(**{SOOT: 0.0}),
    "albedo": lambda: splits.albedo(make_snow(), SKY, [500, 800], max_stderr=0.1, bands=BANDS),
    "albedo of several": lambda: splits.albedo(
        make_several_media(), SKY, [500, 800], max_stderr=0.1
    ),
    "hdrf": lambda: splits.hdrf(make_layer(), SKY, PAIR, relative_stderr=0.5),
    "radiation_profile": lambda: splits.radiation_profile(
        make_snow(), SKY, PAIR, depth_m=[0.01], max_stderr=0.1, total_w_m2=400
    ),
    "retrieve": lambda: (
        splits.retrieve(MEASURED, make_snowlike_table(), FREE_PARAMETERS, 0.01, fixed=FIXED).dataset
    ),
    "retrieve_return": lambda: (
        splits.retrieve_return(
            ([0.0, 1e-10, 1e-9], [2e9, 1e8]), make_return_table(), ["optical_radius_um"], 1e8
        ).dataset
    ),
    "select_principal_plane": lambda: splits.select_principal_plane(
        splits.goniophotometer(
            make_snow(), [1300], 30.0, polar_deg=[0.0, 40.0], azimuth_deg=[0.0, 180.0], **ORDINATES
        )
    ),
    "retrieve_map": lambda: splits.retrieve_map(
        make_image(), make_snowlike_table(), FREE_PARAMETERS, 0.01, fixed=FIXED
    ),
    "retrieve_map, stacked": lambda: splits.retrieve_map(
        make_image().stack(pixel=("y", "x")),
        make_snowlike_table(),
        FREE_PARAMETERS,
        0.01,
        fixed=FIXED,
    ),
}
"""Functions that return the result of every public function that returns data."""
NO_DATASET = {
    "Interpretation", "ParticleLayer", "Progress", "ProgressBar", "RoughSurface", "Sand",
    "SandInterpretation", "Sky", "Snow", "Stack", "__version__", "list_media", "load",
    "draw", "load_medium", "make_colour_table", "read_caaml",
    "read_crocus", "read_snow_packs", "save", "sensor_bands", "sky",
}  # fmt: skip
"""Public names of inputs, of reading and writing, and of progress reports."""


def test_all_public_functions_are_covered():
    named = {name.partition(",")[0].split()[0].split(".")[0] for name in RESULTS}
    assert named | NO_DATASET == {*splits.__all__} and not named & NO_DATASET


def are_attributes_equal(one, other):
    """Return whether attributes are equal as far as netCDF distinguishes them."""
    return np.array_equal(np.ravel(one), np.ravel(other))


@NEEDS_JIT
@pytest.mark.parametrize("name", RESULTS)
def test_results_are_saved_and_loaded(name, tmp_path):
    result = RESULTS[name]()
    splits.save(result, tmp_path / "kept.nc")
    loaded = splits.load(tmp_path / "kept.nc")
    xr.testing.assert_equal(loaded, result)
    assert loaded.indexes.keys() == result.indexes.keys()
    for key in result.variables:
        kinds = {loaded[key].dtype.kind, result[key].dtype.kind}
        assert len(kinds) == 1 or kinds == {"O", "U"}
        assert loaded[key].dims == result[key].dims
        assert all(
            are_attributes_equal(loaded[key].attrs[k], v) for k, v in result[key].attrs.items()
        )
    assert all(
        are_attributes_equal(loaded.attrs[key], value) for key, value in result.attrs.items()
    )
    splits.save(loaded, tmp_path / "again.nc")
    assert splits.load(tmp_path / "again.nc").identical(loaded)


def test_results_without_attributes_are_loaded(tmp_path):
    subset = make_snowlike_table().dataset.reflectance.mean(SIZE).to_dataset()
    assert not subset.attrs
    splits.save(subset, tmp_path / "part.nc")
    assert splits.load(tmp_path / "part.nc").equals(subset)


def make_colliding_dataset(**coordinates):
    values = ("wave", [0.5, 0.6])
    return xr.Dataset({"reflectance": values, "own.name": values, "own_name": values}, coordinates)


COLLIDING_DATASETS = {
    "names that differ in dots": make_colliding_dataset(),
    "a label of an axis of texts": make_colliding_dataset(
        wave=["a", "b"], wave_label=("wave", ["first", "second"])
    ),
    "a value of an unordered axis": make_colliding_dataset(
        wave=[2.0, 2.0], wave_value=("wave", [1.0, 3.0])
    ),
    "a label of no axis": make_colliding_dataset(wave_label=("wave", ["first", "second"])),
    "blanks": make_colliding_dataset(**{"my soot. 2": ("wave", [1.0, 2.0])}),
    "a dimension with dots and blanks": make_colliding_dataset(wave=["a", "b"]).rename(
        wave="my wave.length"
    ),
}


@pytest.mark.parametrize("name", COLLIDING_DATASETS)
def test_names_that_collide_in_the_file_are_kept(name, tmp_path):
    splits.save(COLLIDING_DATASETS[name], tmp_path / "odd.nc")
    assert splits.load(tmp_path / "odd.nc").equals(COLLIDING_DATASETS[name])


def test_pixels_with_gaps_are_nan_and_flagged(tmp_path):
    result = splits.retrieve_map(
        make_image(), make_snowlike_table(), FREE_PARAMETERS, 0.01, fixed=FIXED
    )
    splits.save(result, tmp_path / "map.nc")
    loaded = splits.load(tmp_path / "map.nc")
    assert np.isnan(loaded[SIZE][0, 1]) and loaded.quality_flag[0, 1] == FLAGS["gap"]
    assert np.isfinite(loaded[SIZE]).sum() == 3
    raw = xr.open_dataset(tmp_path / "map.nc", mask_and_scale=False)
    assert np.isnan(raw[SIZE].attrs["_FillValue"])
    assert raw[SIZE].attrs["ancillary_variables"].split()[-1] == "quality_flag"


def test_lazy_arrays_are_computed_once(tmp_path):
    computed = []

    def record_block(block):
        computed.append(block.shape)
        return block

    values = dask.array.ones((4, 3), chunks=(2, 3)).map_blocks(
        record_block, dtype=float, meta=np.ones(1)
    )
    dataset = xr.Dataset({"one": (("y", "x"), values), "other": (("y", "x"), 2.0 * values)})
    splits.save(dataset, tmp_path / "kept.nc")
    assert computed == [(2, 3), (2, 3)]
    assert isinstance(dataset.one.data, dask.array.Array)


@pytest.mark.parametrize("change", [{"chi2": np.inf}, {"quality_flag": 0}])
def test_gaps_without_a_flag_are_rejected(change, tmp_path):
    result = splits.retrieve_map(
        make_image(), make_snowlike_table(), FREE_PARAMETERS, 0.01, fixed=FIXED
    )
    for name, value in change.items():
        result[name][0, 1] = value
    with pytest.raises(ValueError, match="holds values that are not finite"):
        splits.save(result, tmp_path / "map.nc")


NON_DATASETS = {
    "an array": (lambda: make_image(), r"'DataArray'.*array.to_dataset\(name='reflectance'\)"),
    "a path": (lambda: "kept.nc", "'str': must be an xarray.Dataset$"),
}  # fmt: skip


@pytest.mark.parametrize("name", NON_DATASETS)
def test_objects_other_than_datasets_are_rejected(name, tmp_path):
    make_object, message = NON_DATASETS[name]
    with pytest.raises(InvalidValue, match=message):
        splits.save(make_object(), tmp_path / "kept.nc")
    assert not list(tmp_path.iterdir())
