"""Ground albedo: inputs, errors and dataset attributes."""

from __future__ import annotations

import numpy as np
import pytest

import splits
from splits.media.ground import BLACK_OPTICAL_DEPTH, Ground, load_soils

W = np.array([450.0, 500.0, 900.0])


def test_a_number_is_a_constant_albedo():
    np.testing.assert_array_equal(Ground.from_input(0.3).albedo(W), 0.3)
    np.testing.assert_allclose(Ground.from_input(0.3).optical_depth(W), -np.log(0.3))
    assert Ground.from_input(1).optical_depth(W).max() == 0.0
    np.testing.assert_array_equal(Ground.from_input(0).optical_depth(W), BLACK_OPTICAL_DEPTH)


@pytest.mark.parametrize("value", [None, "open"])
def test_open_means_no_ground(value):
    assert Ground.from_input(value) is None
    assert splits.Snow(ground=value).describe()["ground"] == "open"


def test_black_ground_does_not_reflect():
    assert not Ground.from_input("black").is_reflecting and not Ground.from_input(0.0).is_reflecting
    assert Ground.from_input(1e-9).is_reflecting


def test_tables_are_interpolated_linearly():
    ground = Ground.from_input({"wavelength_nm": [400, 500, 1000], "albedo": [0.0, 0.2, 0.7]})
    np.testing.assert_allclose(ground.albedo(W), [0.1, 0.2, 0.6])
    attributes = splits.Snow(ground=ground).describe()
    assert attributes["ground"] == "table" and attributes["ground_albedo"][2] == 0.7


def test_soils_have_names_and_a_source():
    assert "camborthid" in load_soils()
    soil = Ground.from_input("camborthid")
    assert "ECOSTRESS" in soil.source and 0.0 < soil.albedo(W)[0] < soil.albedo(W)[2] < 1.0
    with pytest.raises(ValueError, match=r"in \[400, 1000\] nm, the range of ground camborthid"):
        soil.albedo(np.array([1200.0]))


def test_files_are_identified_by_content(tmp_path):
    path = tmp_path / "field.csv"
    path.write_text("# mine\nwavelength_nm, albedo\n400, 0.1\n1000, 0.3\n")
    ground = splits.Sand(ground=path).ground
    assert ground.albedo(np.array([700.0])) == pytest.approx(0.2)
    attributes = splits.Sand(ground=str(path)).describe()
    assert attributes["ground"] == "field.csv" and len(attributes["ground_sha256"]) == 64


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (1.5, r"ground = 1.5: must be in \[0, 1\]"),
        (True, "ground = True: must be open, black"),
        ("blak", r"did you mean black\?"),
        ("chalk", "soils: quartzipsamment"),
        ("mine.csv", "an existing CSV file"),
        ({"albedo": [0.1]}, "a mapping of wavelength_nm, albedo"),
        ({"wavelength_nm": [400, 500], "albedo": [0.1]}, "2 wavelength_nm, 1 albedo"),
        ({"wavelength_nm": [500, 400], "albedo": [0.1, 0.2]}, "strictly increasing"),
        ({"wavelength_nm": [400, 500], "albedo": [0.1, 1.2]}, r"ground.albedo = 1.2"),
    ],
)
def test_invalid_grounds_are_rejected(value, message):
    with pytest.raises(ValueError, match=message):
        splits.Snow(ground=value)


def test_instruments_for_transmitted_light_reject_a_ground():
    snow = splits.Snow(depth_m=0.01, ground=0.5)
    with pytest.raises(ValueError, match="target = 'btdf': must be brdf over a ground"):
        splits.goniophotometer(snow, 500.0, target="btdf")


def test_a_stack_has_one_ground():
    with pytest.raises(ValueError, match=r"layers\[1\].ground = 'albedo 0.5': must be left out"):
        splits.Stack([splits.Snow(), splits.Snow(ground=0.5)])
    stack = splits.Stack([splits.Snow()], ground="black")
    assert stack.describe()["ground"] == "black" and "layers_0_ground" not in stack.describe()
