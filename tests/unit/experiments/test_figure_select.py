"""Selection of the point of a grid in a figure."""

import numpy as np
import pytest
import xarray as xr

from splits.experiments import ExperimentConfig
from splits.experiments.config.media import find_label, label_grid, to_coordinate_values
from splits.io.netcdf import select_points

CROSSED_GRID = {"0.1": 1.0, "1": 0.1}


def resolve_fixed_values(grid, **select):
    """Return the fixed values of the figure of an experiment, and the grid."""
    experiment = ExperimentConfig(name="made", grid=grid, figure={"select": select})
    return experiment.resolve_figure()["select"], experiment.grid


@pytest.mark.parametrize(
    ("values", "value", "label"),
    [
        ([0.99999, 1.0], 1.0, "1"),
        ([0.99999, 1.0], 0.99999, "0.99999"),
        (CROSSED_GRID, "0.1", "0.1"),
        (CROSSED_GRID, 0.1, "1"),
        (CROSSED_GRID, 1, "0.1"),
        ({"dry": 0, "wet": 1}, "wet", "wet"),
        ({"dry": 0, "wet": 1}, 1, "wet"),
        ([[100, 200], [300, 400]], "300-400", "300-400"),
        ([[0.2, 0.4, 0.3, 0.072], [0.5, 0.7, 0.6, 0.072]], 0.6, "0.6"),
        ({"beam": 60, "sky": "diffuse"}, "diffuse", "sky"),
        ({"beam": 60, "sky": "diffuse"}, 60, "beam"),
    ],
)
def test_texts_select_labels_and_numbers_values(values, value, label):
    values = label_grid({"x": values})["x"]
    assert find_label("x", values, value) == label


@pytest.mark.parametrize("value", [0.5, 0.999999999, "1.0", "moist", 0.09999])
def test_values_outside_the_grid_are_rejected(value):
    with pytest.raises(
        ValueError, match=r"figure\.select\.saturation = .*: must be one of 0\.1, 1"
    ):
        resolve_fixed_values({"saturation": CROSSED_GRID}, saturation=value)


def test_selection_uses_the_coordinates_of_the_dataset():
    select, grid = resolve_fixed_values({"saturation": CROSSED_GRID}, saturation="0.1")
    assert select == {"saturation": 1.0}
    assert to_coordinate_values(grid["saturation"]).tolist() == [1.0, 0.1]
    select, _ = resolve_fixed_values({"saturation": {"dry": 0, "wet": 1}}, saturation="wet")
    assert select == {"saturation": 1.0}
    grid = {"incidence_deg": {"beam": 60, "sky": "diffuse"}}
    assert resolve_fixed_values(grid, incidence_deg="diffuse")[0] == {"incidence_deg": "sky"}
    grid = {"polarized": [True, False]}
    layer = {"kind": "particle_layer"}
    experiment = ExperimentConfig(
        name="made", medium=layer, grid=grid, instrument={"wavelength_nm": [500, 550]},
        figure={"select": {"polarized": True}},
    )  # fmt: skip
    assert experiment.resolve_figure()["select"] == {"polarized": "True"}


def test_points_are_selected_up_to_rounding():
    x = np.array([0.99999, 1.0, 0.1 * 3])
    dataset = xr.Dataset({"y": ("x", np.arange(3.0))}, {"x": x})
    assert float(select_points(dataset, {"x": 1.0}).y) == 1.0
    assert float(select_points(dataset, {"x": 0.3}).y) == 2.0
    for invalid in (0.999995, "beam", np.nan):
        with pytest.raises(ValueError, match=r"^at\.x = "):
            select_points(dataset, {"x": invalid})
    with pytest.raises(ValueError, match=r"^at = 'z': must be one of x"):
        select_points(dataset, {"z": 1.0})


def test_start_stop_and_step_are_evenly_spaced_values():
    grid = label_grid({"incidence_deg": {"start": 0, "stop": 80, "step": 10}})
    assert list(grid["incidence_deg"].values()) == [0, 10, 20, 30, 40, 50, 60, 70, 80]
    grid = label_grid({"saturation": {"start": 0, "stop": 0.3, "step": 0.1}})
    assert grid["saturation"] == {"0": 0.0, "0.1": 0.1, "0.2": 0.2, "0.3": 0.3}
    for missing in ("start", "stop", "step"):
        steps = {"start": 0, "stop": 80, "step": 10}
        del steps[missing]
        with pytest.raises(ValueError, match=rf"grid\.incidence_deg\.{missing} = None: must be"):
            label_grid({"incidence_deg": steps})
    media = {"start": {"saturation": 0}, "stop": {"saturation": 1}}
    assert label_grid({"medium": media}) == {"medium": media}


def test_two_labels_of_one_value_are_rejected():
    with pytest.raises(ValueError, match=r"grid\.saturation = .*: must be different values"):
        label_grid({"saturation": {"a": 0.1, "b": 0.1}})
