"""Coordinates of datasets: units and long names, and files that follow the CF conventions."""

import netCDF4
import numpy as np
import pytest
import xarray as xr

import splits
from splits.core.declarations import list_inputs
from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.sections import Accuracy
from splits.experiments.run import run
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.media.kinds import MEDIUM_CLASSES
from splits.media.parameters import DERIVED_QUANTITIES, list_declared_quantities

WAVES = {"rms_height_m": 0.01, "wave_number_per_m": 20, "waves": 8, "correlation": "gaussian"}
LENS = {
    "name": "small_lens",
    "medium": {"kind": "particle_layer", "surface": WAVES},
    "instrument": {
        "kind": "lens", "radius_m": 0.01, "screen_depth_m": [0.05, 0.1], "centre_on": "origin",
        "rays": 3,
    },
    "grid": {"refractive_index": [1.5, 1.3, 1.4], "polarized": {"no": False, "yes": True}},
    "figure": {"select": {"refractive_index": 1.5, "polarized": "no"}},
}  # fmt: skip


@pytest.fixture(scope="module")
def dataset():
    """Return a dataset over texts and over unordered, increasing and decreasing numbers."""
    return xr.Dataset(
        {
            "reflectance": (("medium", "depth_m"), np.arange(6.0).reshape(2, 3), {"units": "1"}),
            "transmittance": (("up", "down"), np.ones((2, 2)), {"units": "1"}),
        },
        {
            "medium": ("medium", ["dune", "beach"], {"long_name": "sample"}),
            "depth_m": ("depth_m", [3.0, 1.0, 2.0], {"long_name": "depth", "units": "m"}),
            "up": ("up", [1, 2], {"units": "1"}),
            "down": ("down", [2.0, 1.0], {"units": "1"}),
        },
        to_netcdf_attributes({"title": "made up", **make_provenance("made by a test")}),
    )


@pytest.fixture(scope="module")
def small_lens():
    """Return the dataset of an experiment that runs quickly."""
    return run(ExperimentConfig.model_validate(LENS), Accuracy(max_stderr=0.5))


def test_every_parameter_has_a_long_name_and_units():
    keywords = {name for medium in MEDIUM_CLASSES.values() for name in list_inputs(medium)}
    described = keywords | {"medium", "incidence_deg", *DERIVED_QUANTITIES}
    assert set(list_declared_quantities()) == described
    assert all(one.long_name and one.unit for one in list_declared_quantities().values())


def test_ranges_have_numeric_means():
    experiment = ExperimentConfig.model_validate(
        {
            "name": "sizes",
            "medium": {"kind": "snow", "depth_m": 0.01},
            "instrument": {"wavelength_nm": [900]},
            "grid": {"grain_size_um": {"fine": [100, 200], "coarse": [400, 800]}},
        }
    )
    ds = run(experiment, Accuracy(max_stderr=0.05))
    assert ds.grain_size_um.values.tolist() == ["fine", "coarse"]
    assert ds.grain_size_um_mean.values.tolist() == [150.0, 600.0]
    assert ds.grain_size_um_mean.attrs["units"] == "um"
    between = ds.swap_dims(grain_size_um="grain_size_um_mean").reflectance.interp(
        grain_size_um_mean=375.0
    )
    assert between.item() == pytest.approx(ds.reflectance.mean().item())


def test_grid_coordinates_have_units_if_they_are_numbers(small_lens):
    index = small_lens.refractive_index
    assert index.attrs == {"long_name": "refractive index", "units": "1"}
    assert "units" not in small_lens.polarized.attrs
    for name, coordinate in small_lens.coords.items():
        assert coordinate.attrs["long_name"], name
        assert coordinate.dtype.kind in "OU" or coordinate.attrs["units"], name


def test_long_names_of_labels_contain_units():
    from splits.experiments.config.media import make_grid_coordinates

    grid = {"grain_size_um": {"100-200": [100, 200]}, "temperature_c": {"-1": -1, "-5": -5}}
    sizes, means, degrees = make_grid_coordinates(grid).values()
    assert means[1].tolist() == [150.0]
    assert sizes[2]["long_name"].endswith("(um)")
    assert degrees[2]["units"] == "degC"
    assert degrees[1].tolist() == [-1.0, -5.0]


def test_history_names_program_and_experiment(small_lens):
    line = small_lens.attrs["history"]
    assert line.startswith(small_lens.attrs["date_created"])
    assert line.endswith(f"{small_lens.attrs['source']}: experiment small_lens")


@pytest.mark.parametrize("fixture", ["dataset", "small_lens"])
def test_coordinate_variables_in_files_are_monotonic(tmp_path, request, fixture):
    expected = request.getfixturevalue(fixture)
    splits.save(expected, tmp_path / "made.nc")
    with netCDF4.Dataset(tmp_path / "made.nc") as file:
        for name in set(file.variables) & set(file.dimensions):
            steps = np.diff(file[name][...])
            assert (steps > 0).all() or (steps < 0).all(), name
        for name, variable in file.variables.items():
            listed = getattr(variable, "coordinates", "").split()
            assert set(listed) <= set(file.variables), name
            for dimension in variable.dimensions:
                labels = {f"{dimension}_label", f"{dimension}_value"} & set(file.variables)
                if name in expected.data_vars:
                    assert labels <= set(listed), name
    loaded = splits.load(tmp_path / "made.nc")
    xr.testing.assert_equal(loaded, expected)
    for name, variable in expected.variables.items():
        assert loaded[name].attrs == variable.attrs, name


def test_selection_by_label_works_before_and_after_saving(tmp_path, dataset):
    splits.save(dataset, tmp_path / "made.nc")
    for ds in (dataset, splits.load(tmp_path / "made.nc")):
        assert float(ds.reflectance.sel(medium="beach", depth_m=1.0)) == 4.0
        assert float(ds.transmittance.sel(up=2, down=1.0)) == 1.0
    with netCDF4.Dataset(tmp_path / "made.nc") as file:
        assert set(file["reflectance"].coordinates.split()) == {"medium_label", "depth_m_value"}
        assert {"up", "down"} <= set(file.variables)
        assert not {"medium", "depth_m"} & set(file.variables)
        assert file["depth_m_value"].units == "m"
