"""Whatever a public function returns is saved, and loaded to the same values."""

from __future__ import annotations

import dask.array
import numpy as np
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


def snow(**changes):
    return splits.Snow.natural(optical_radius_um=100, depth_m=0.02, **changes)


def layer(**changes):
    return splits.ParticleLayer(optical_thickness=1.0, **changes)


def rough():
    surface = {"rms_height_m": 0.01, "wave_number_per_m": 2, "correlation": "gaussian"}
    return layer(surface=surface)


def make_several_media():
    return {"clean": snow(), "dirty": snow(impurities_ng_g={"black_carbon": 50})}


def grains():
    return splits.single_scattering(snow(), PAIR, moments=8, rays=100)


def make_place(**more):
    return {SIZE: 120.0, SOOT: 30.0, "incidence_deg": 20.0, **more}


def small_table(**keywords):
    def make(black_carbon, ground):
        return snow(impurities_ng_g={"black_carbon": black_carbon}, ground=ground)

    grid = {"black_carbon": [0, 50], "ground": ["black", "open"], "incidence_deg": [0, 60]}
    return splits.build_table(make, grid, PAIR, max_stderr=0.1, **keywords)


def image():
    """Return an image over bands whose pixels are stacked, one of which has a gap."""
    values = np.array(
        [[evaluate_spectrum(size, dirt) for dirt in (20.0, 200.0)] for size in (60.0, 900.0)]
    )
    values[0, 1, 3] = np.nan
    axes = {"wavelength": ("band", W), "y": [10.0, 20.0], "x": [1.0, 2.0]}
    return xr.DataArray(values, axes, ("y", "x", "band"))


RESULTS = {
    "spectrophotometer": lambda: splits.spectrophotometer(layer(), PAIR, max_stderr=0.1),
    "spectrophotometer, derivatives": lambda: splits.spectrophotometer(
        layer(), PAIR, max_stderr=0.1, jacobian=["single_scattering_albedo"]
    ),
    "spectrophotometer, several": lambda: splits.spectrophotometer(
        make_several_media(), PAIR, max_stderr=0.1
    ),
    "goniophotometer": lambda: splits.goniophotometer(layer(), PAIR, 30.0, relative_stderr=0.5),
    "beam_spread": lambda: splits.beam_spread(layer(), PAIR, rays=1000, half_width_m=1.0),
    "irradiance_profile": lambda: splits.irradiance_profile(snow(), PAIR, [0.01], max_stderr=0.1),
    "deep_transmittance": lambda: splits.deep_transmittance(snow(), PAIR, relative_stderr=0.5),
    "lens": lambda: splits.lens(rough(), [1.0], 0.1, centre_on="origin", rays=1000),
    "surface_map": lambda: splits.surface_map(rough(), 1.0, points=5, realizations=2),
    "single_scattering": grains,
    "with_diffraction": lambda: splits.with_diffraction(grains()),
    "phase_function": lambda: splits.phase_function(grains(), [0, 90, 180]),
    "build_table": small_table,
    "build_table, covariance": lambda: small_table(covariance=True),
    "Table": lambda: make_snowlike_table().dataset,
    "Table.interp": lambda: make_snowlike_table().interp(**make_place()),
    "Table.derivatives": lambda: make_snowlike_table().derivatives(FREE_PARAMETERS, **make_place()),
    "Table.to_isofit": lambda: make_snowlike_table().to_isofit(**{SOOT: 0.0}),
    "Table.to_spires": lambda: make_snowlike_table().to_spires(SOOT, BANDS).to_dataset(),
    "albedo": lambda: splits.albedo(snow(), SKY, [500, 800], 0.1, bands=BANDS),
    "albedo of several": lambda: splits.albedo(make_several_media(), SKY, [500, 800], 0.1),
    "hdrf": lambda: splits.hdrf(layer(), SKY, PAIR, 0.5),
    "radiation_profile": lambda: splits.radiation_profile(
        snow(), SKY, [0.01], PAIR, 0.1, total_w_m2=400
    ),
    "retrieve": lambda: (
        splits.retrieve(MEASURED, make_snowlike_table(), FREE_PARAMETERS, 0.01, fixed=FIXED).dataset
    ),
    "retrieve_map": lambda: splits.retrieve_map(
        image(), make_snowlike_table(), FREE_PARAMETERS, 0.01, fixed=FIXED
    ),
    "retrieve_map, stacked": lambda: splits.retrieve_map(
        image().stack(pixel=("y", "x")), make_snowlike_table(), FREE_PARAMETERS, 0.01, fixed=FIXED
    ),
    "select_bands": lambda: splits.select_bands(
        make_snowlike_table(), W[:4], FREE_PARAMETERS, 0.01, 2, fixed=FIXED
    ),
    "sobol_indices": lambda: splits.sobol_indices(
        make_snowlike_table(), FREE_PARAMETERS, fixed=FIXED, points=64
    ),
}
"""What every public function returns that returns data, by its name and what differs."""
MISSING_DATA = {
    "Interpretation", "ParticleLayer", "Progress", "ProgressBar", "RoughSurface", "Sand",
    "SandInterpretation", "Sky",
    "Snow", "Stack", "__version__", "load", "open_table", "save", "save_brdf", "sensor_bands",
    "sky",
}  # fmt: skip
"""Public names of inputs, of what reads and writes, and of what tells of a run."""


def test_no_public_function_is_left_out():
    named = {name.partition(",")[0].split()[0].split(".")[0] for name in RESULTS}
    assert named | MISSING_DATA == {*splits.__all__} and not named & MISSING_DATA


def attributes_equal(one, other):
    """Tell whether attributes are the same but for what netCDF cannot tell apart."""
    return np.array_equal(np.ravel(one), np.ravel(other))


@NEEDS_JIT
@pytest.mark.parametrize("name", RESULTS)
def test_what_is_returned_is_saved_and_loaded(name, tmp_path):
    found = RESULTS[name]()
    splits.save(found, tmp_path / "kept.nc")
    again = splits.load(tmp_path / "kept.nc")
    xr.testing.assert_equal(again, found)
    assert again.indexes.keys() == found.indexes.keys()
    for key in found.variables:
        kinds = {again[key].dtype.kind, found[key].dtype.kind}
        assert len(kinds) == 1 or kinds == {"O", "U"}
        assert again[key].dims == found[key].dims
        assert all(attributes_equal(again[key].attrs[k], v) for k, v in found[key].attrs.items())
    assert all(attributes_equal(again.attrs[key], value) for key, value in found.attrs.items())
    splits.save(again, tmp_path / "again.nc")
    assert splits.load(tmp_path / "again.nc").identical(again)


def test_a_part_of_a_result_is_loaded_too(tmp_path):
    part = make_snowlike_table().dataset.reflectance.mean(SIZE).to_dataset()
    assert not part.attrs
    splits.save(part, tmp_path / "part.nc")
    assert splits.load(tmp_path / "part.nc").equals(part)


def make_odd_dataset(**coordinates):
    values = ("wave", [0.5, 0.6])
    return xr.Dataset({"reflectance": values, "own.name": values, "own_name": values}, coordinates)


ODD_DATASETS = {
    "names alike but for dots": make_odd_dataset(),
    "a label of an axis of texts": make_odd_dataset(
        wave=["a", "b"], wave_label=("wave", ["first", "second"])
    ),
    "a value of an axis in no order": make_odd_dataset(
        wave=[2.0, 2.0], wave_value=("wave", [1.0, 3.0])
    ),
    "a label of no axis": make_odd_dataset(wave_label=("wave", ["first", "second"])),
    "blanks": make_odd_dataset(**{"my soot. 2": ("wave", [1.0, 2.0])}),
    "a dimension with dots and blanks": make_odd_dataset(wave=["a", "b"]).rename(
        wave="my wave.length"
    ),
}


@pytest.mark.parametrize("name", ODD_DATASETS)
def test_names_that_meet_in_the_file_stay_apart(name, tmp_path):
    splits.save(ODD_DATASETS[name], tmp_path / "odd.nc")
    assert splits.load(tmp_path / "odd.nc").equals(ODD_DATASETS[name])


def test_a_pixel_with_a_gap_is_nan_in_the_file_and_says_why(tmp_path):
    found = splits.retrieve_map(image(), make_snowlike_table(), FREE_PARAMETERS, 0.01, fixed=FIXED)
    splits.save(found, tmp_path / "map.nc")
    again = splits.load(tmp_path / "map.nc")
    assert np.isnan(again[SIZE][0, 1]) and again.flags[0, 1] == FLAGS["gap"]
    assert np.isfinite(again[SIZE]).sum() == 3
    plain = xr.open_dataset(tmp_path / "map.nc", mask_and_scale=False)
    assert np.isnan(plain[SIZE].attrs["_FillValue"])
    assert plain[SIZE].attrs["ancillary_variables"].split()[-1] == "flags"


def test_what_is_not_computed_yet_is_computed_once(tmp_path):
    asked = []

    def look(block):
        asked.append(block.shape)
        return block

    values = dask.array.ones((4, 3), chunks=(2, 3)).map_blocks(look, dtype=float, meta=np.ones(1))
    both = xr.Dataset({"one": (("y", "x"), values), "other": (("y", "x"), 2.0 * values)})
    splits.save(both, tmp_path / "kept.nc")
    assert asked == [(2, 3), (2, 3)]
    assert isinstance(both.one.data, dask.array.Array)


@pytest.mark.parametrize("change", [{"chi2": np.inf}, {"flags": 0}])
def test_gaps_without_a_flag_are_refused(change, tmp_path):
    found = splits.retrieve_map(image(), make_snowlike_table(), FREE_PARAMETERS, 0.01, fixed=FIXED)
    for name, value in change.items():
        found[name][0, 1] = value
    with pytest.raises(ValueError, match="holds values that are not finite"):
        splits.save(found, tmp_path / "map.nc")


NON_DATASETS = {
    "an array": (lambda: image(), r"'DataArray'.*array.to_dataset\(name='reflectance'\)"),
    "a table": (make_snowlike_table, r"'Table'.*write its dataset"),
    "a retrieval": (lambda: splits.retrieve(MEASURED, make_snowlike_table(), FREE_PARAMETERS, 0.01,
                                            fixed=FIXED),
                    r"'RetrievalResult'.*write its dataset"),
    "a path": (lambda: "kept.nc", "'str': must be an xarray.Dataset$"),
}  # fmt: skip


@pytest.mark.parametrize("name", NON_DATASETS)
def test_what_is_no_dataset_is_refused_in_a_line(name, tmp_path):
    make, line = NON_DATASETS[name]
    with pytest.raises(InvalidValue, match=line):
        splits.save(make(), tmp_path / "kept.nc")
    assert not list(tmp_path.iterdir())
