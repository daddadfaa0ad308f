"""Whatever a public function returns is saved, and loaded to the same values."""

from __future__ import annotations

import dask.array
import numpy as np
import pytest
import xarray as xr
from chi2 import NEEDS_JIT
from formula_tables import W, snowlike, spectrum

import splits
from splits.checks import Refusal
from splits.retrieval.maps import FLAGS

SIZE, DIRT = "optical_radius_um", "impurities_ng_g.black_carbon"
FREE, AT = [SIZE, DIRT], {"incidence_deg": 30.0}
PAIR = [500.0, 1030.0]
SKY = "midlatitude_winter"
BANDS = {"visible": (500, 1000)}
MEASURED = (W, spectrum(150.0, 50.0))


def snow(**changes):
    return splits.Snow.natural(optical_radius_um=100, depth_m=0.02, **changes)


def layer(**changes):
    return splits.Layer(optical_thickness=1.0, **changes)


def rough():
    surface = {"rms_height_m": 0.01, "wave_number_per_m": 2, "correlation": "gaussian"}
    return layer(surface=surface)


def several():
    return {"clean": snow(), "dirty": snow(impurities_ng_g={"black_carbon": 50})}


def grains():
    return splits.single_scattering(snow(), PAIR, moments=8, rays=100)


def place(**more):
    return {SIZE: 120.0, DIRT: 30.0, "incidence_deg": 20.0, **more}


def small_table(**keywords):
    def make(black_carbon, ground):
        return snow(impurities_ng_g={"black_carbon": black_carbon}, ground=ground)

    grid = {"black_carbon": [0, 50], "ground": ["black", "open"], "incidence_deg": [0, 60]}
    return splits.table(make, grid, PAIR, max_stderr=0.1, **keywords)


def image():
    """Return an image over bands whose pixels are stacked, one of which has a gap."""
    values = np.array([[spectrum(size, dirt) for dirt in (20.0, 200.0)] for size in (60.0, 900.0)])
    values[0, 1, 3] = np.nan
    axes = {"wavelength": ("band", W), "y": [10.0, 20.0], "x": [1.0, 2.0]}
    return xr.DataArray(values, axes, ("y", "x", "band"))


RESULTS = {
    "spectrophotometer": lambda: splits.spectrophotometer(layer(), PAIR, max_stderr=0.1),
    "spectrophotometer, derivatives": lambda: splits.spectrophotometer(
        layer(), PAIR, max_stderr=0.1, jacobian=["single_scattering_albedo"]
    ),
    "spectra": lambda: splits.spectra(several(), PAIR, max_stderr=0.1),
    "goniophotometer": lambda: splits.goniophotometer(layer(), PAIR, 30.0, relative_stderr=0.5),
    "bssrdf": lambda: splits.bssrdf(layer(), PAIR, rays=1000, half_width_m=1.0),
    "profile": lambda: splits.profile(snow(), PAIR, [0.01], max_stderr=0.1),
    "deep_transmittance": lambda: splits.deep_transmittance(snow(), PAIR, relative_stderr=0.5),
    "lens": lambda: splits.lens(rough(), [1.0], 0.1, over="origin", rays=1000),
    "surface_map": lambda: splits.surface_map(rough(), 1.0, points=5, realisations=2),
    "single_scattering": grains,
    "with_diffraction": lambda: splits.with_diffraction(grains()),
    "phase_function": lambda: splits.phase_function(grains(), [0, 90, 180]),
    "table": small_table,
    "table, covariance": lambda: small_table(covariance=True),
    "Table": lambda: snowlike().dataset,
    "Table.interp": lambda: snowlike().interp(**place()),
    "Table.derivatives": lambda: snowlike().derivatives(FREE, **place()),
    "Table.to_isofit": lambda: snowlike().to_isofit(**{DIRT: 0.0}),
    "Table.to_spires": lambda: snowlike().to_spires(DIRT, BANDS).to_dataset(),
    "albedo": lambda: splits.albedo(snow(), SKY, [500, 800], 0.1, bands=BANDS),
    "albedo of several": lambda: splits.albedo(several(), SKY, [500, 800], 0.1),
    "hdrf": lambda: splits.hdrf(layer(), SKY, PAIR, 0.5),
    "light_inside": lambda: splits.light_inside(snow(), SKY, [0.01], PAIR, 0.1, total_w_m2=400),
    "retrieve": lambda: splits.retrieve(MEASURED, snowlike(), FREE, 0.01, at=AT).dataset,
    "retrieve_map": lambda: splits.retrieve_map(image(), snowlike(), FREE, 0.01, at=AT),
    "retrieve_map, stacked": lambda: splits.retrieve_map(
        image().stack(pixel=("y", "x")), snowlike(), FREE, 0.01, at=AT
    ),
    "best_bands": lambda: splits.best_bands(snowlike(), W[:4], FREE, 0.01, 2, at=AT),
    "sobol_indices": lambda: splits.sobol_indices(snowlike(), FREE, at=AT, points=64),
}
"""What every public function returns that returns data, by its name and what differs."""
NO_DATA = {
    "Layer", "Progress", "ProgressBar", "Readings", "RoughSurface", "Sand", "SandReadings", "Sky",
    "Snow", "Stack", "__version__", "load", "open_table", "save", "save_brdf", "sensor", "sky",
}  # fmt: skip
"""Public names of inputs, of what reads and writes, and of what tells of a run."""


def test_no_public_function_is_left_out():
    named = {name.partition(",")[0].split()[0].split(".")[0] for name in RESULTS}
    assert named | NO_DATA == {*splits.__all__} and not named & NO_DATA


def same(one, other):
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
        assert all(same(again[key].attrs[k], v) for k, v in found[key].attrs.items())
    assert all(same(again.attrs[key], value) for key, value in found.attrs.items())
    splits.save(again, tmp_path / "again.nc")
    assert splits.load(tmp_path / "again.nc").identical(again)


def test_a_part_of_a_result_is_loaded_too(tmp_path):
    part = snowlike().dataset.reflectance.mean(SIZE).to_dataset()
    assert not part.attrs
    splits.save(part, tmp_path / "part.nc")
    assert splits.load(tmp_path / "part.nc").equals(part)


def odd(**coordinates):
    values = ("wave", [0.5, 0.6])
    return xr.Dataset({"reflectance": values, "own.name": values, "own_name": values}, coordinates)


ODD = {
    "names alike but for dots": odd(),
    "a label of an axis of texts": odd(wave=["a", "b"], wave_label=("wave", ["first", "second"])),
    "a value of an axis in no order": odd(wave=[2.0, 2.0], wave_value=("wave", [1.0, 3.0])),
    "a label of no axis": odd(wave_label=("wave", ["first", "second"])),
    "blanks": odd(**{"my soot. 2": ("wave", [1.0, 2.0])}),
    "a dimension with dots and blanks": odd(wave=["a", "b"]).rename(wave="my wave.length"),
}


@pytest.mark.parametrize("name", ODD)
def test_names_that_meet_in_the_file_stay_apart(name, tmp_path):
    splits.save(ODD[name], tmp_path / "odd.nc")
    assert splits.load(tmp_path / "odd.nc").equals(ODD[name])


def test_a_pixel_with_a_gap_is_nan_in_the_file_and_says_why(tmp_path):
    found = splits.retrieve_map(image(), snowlike(), FREE, 0.01, at=AT)
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
    found = splits.retrieve_map(image(), snowlike(), FREE, 0.01, at=AT)
    for name, value in change.items():
        found[name][0, 1] = value
    with pytest.raises(ValueError, match="holds values that are not finite"):
        splits.save(found, tmp_path / "map.nc")


NO_DATASETS = {
    "an array": (lambda: image(), r"'DataArray'.*array.to_dataset\(name='reflectance'\)"),
    "a table": (snowlike, r"'Table'.*write its dataset"),
    "a retrieval": (lambda: splits.retrieve(MEASURED, snowlike(), FREE, 0.01, at=AT),
                    r"'Retrieved'.*write its dataset"),
    "a path": (lambda: "kept.nc", "'str': must be an xarray.Dataset$"),
}  # fmt: skip


@pytest.mark.parametrize("name", NO_DATASETS)
def test_what_is_no_dataset_is_refused_in_a_line(name, tmp_path):
    make, line = NO_DATASETS[name]
    with pytest.raises(Refusal, match=line):
        splits.save(make(), tmp_path / "kept.nc")
    assert not list(tmp_path.iterdir())
