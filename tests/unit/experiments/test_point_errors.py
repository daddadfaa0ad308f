"""Target errors of the points of a grid."""

import pytest

from splits.experiments.config.experiment import ExperimentConfig
from splits.experiments.config.load import validate_content
from splits.experiments.config.sections import Accuracy
from splits.experiments.run import run

LAYER = {"kind": "particle_layer", "optical_thickness": 1.0, "single_scattering_albedo": 0.9}


def make(instrument, grid, medium=LAYER, **more):
    content = {"name": "made", "medium": medium, "grid": grid, **more}
    spectrum = {"kind": "spectrophotometer", "wavelength_nm": [550], "solver": "monte_carlo"}
    return validate_content(
        ExperimentConfig, content | {"instrument": {**spectrum, **instrument}, "figure": "none"}
    )


def test_points_of_a_grid_reach_their_own_errors():
    grid = {"optical_thickness": [1.0, 4.0], "asymmetry": [0.0, 0.5]}
    scales = [4.0, 0.5, 2.0, 1.0]
    given = {"stderr_scale": 0.5, "point_stderr_scale": scales}
    dataset = run(make(given, grid), Accuracy(max_stderr=0.02), threads=1)
    reached = dataset.reflectance_stderr.values[..., 0].ravel()
    targets = [0.5 * 0.02 * scale for scale in scales]
    assert (reached <= targets).all()
    assert reached[1] < min(reached[0], reached[2])
    plain = run(make({}, grid), Accuracy(max_stderr=0.01), threads=1)
    assert dataset.reflectance[1, 1].equals(plain.reflectance[1, 1])


def test_points_that_share_paths_reach_the_smallest_of_their_errors():
    grid, medium = {"impurities_ng_g.black_carbon": [0.0, 100.0]}, {"depth_m": 0.005}
    experiment = make({"point_stderr_scale": [1.0, 0.25]}, grid, medium)
    lines = []
    dataset = run(experiment, Accuracy(max_stderr=0.02), threads=1, log=lines.append)
    assert "1 sets of paths for 2 points" in lines[0]
    assert (dataset.reflectance_stderr <= 0.25 * 0.02).all()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"instrument": {"point_stderr_scale": [1, 2]}}, "must be 4 numbers, one for each point"),
        ({"instrument": {"point_stderr_scale": [1, 1, 1, 0]}}, r"point_stderr_scale\[3] = 0"),
        ({"instrument": {"point_stderr_scale": [2], "kind": "table"}}, "must be left out for tab"),
        (
            {"instrument": {"kind": "goniophotometer", "rays": 9, "point_stderr_scale": [1] * 4}},
            "must be left out with rays",
        ),
    ],
)
def test_errors_that_do_not_match_the_grid_are_rejected(content, message):
    grid = {"optical_thickness": [1.0, 4.0], "asymmetry": [0.0, 0.5]}
    with pytest.raises(ValueError, match=message) as error:
        make(content["instrument"], grid)
    assert "point_stderr_scale" in str(error.value)
