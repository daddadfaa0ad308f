"""Validation: every message names the key, the value and the allowed range."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

from splits.core.arrays import check_named_numbers
from splits.core.validation import (
    check_choice,
    check_number,
    check_range,
    invalid,
    suggest_name,
    unknown_key,
)


def test_errors_name_key_value_range_and_hint():
    error = invalid("depth_m", -1, "above 0", "think positive")
    assert str(error) == "depth_m = -1: must be above 0 (think positive)"
    assert str(invalid("depth_m", "x", "above 0")) == "depth_m = 'x': must be above 0"
    assert isinstance(error, ValueError)


@pytest.mark.parametrize("value", [1, 1.5, np.float32(0.5), np.int64(3), -0.0])
def test_real_numbers_are_converted_to_float(value):
    result = check_number("x", value)
    assert type(result) is float
    assert result == float(value)


@pytest.mark.parametrize("value", [True, None, "1", 1j, [1], math.nan, math.inf, np.bool_(True)])
def test_other_values_are_rejected_as_numbers(value):
    with pytest.raises(ValueError, match=r"^x = .*: must be a finite number"):
        check_number("x", value)


@pytest.mark.parametrize(
    ("limits", "inside", "outside", "allowed"),
    [
        ({}, (0.0, 0.5, 1.0), (-1e-9, 1.1), r"in \[0, 1\] m"),
        ({"open_low": True}, (1e-9, 1.0), (0.0,), r"in \(0, 1\] m"),
        ({"open_high": True}, (0.0, 0.999), (1.0,), r"in \[0, 1\) m"),
        ({"high": math.inf}, (0.0, 1e300), (-1.0, math.inf), "at least 0 m"),
        ({"high": math.inf, "open_low": True}, (1e-300,), (0.0,), "above 0 m"),
    ],
)
def test_ranges_include_their_limits_unless_open(limits, inside, outside, allowed):
    arguments = {"low": 0.0, "high": 1.0, "unit": "m", "hint": "look", **limits}
    for value in inside:
        assert check_range("x", value, **arguments) == value
    for value in outside:
        with pytest.raises(ValueError, match=f"^x = {value}: must be {allowed}"):
            check_range("x", value, **arguments)


def test_the_hint_is_at_the_end():
    with pytest.raises(ValueError, match=r"\[0, 1\] \(use less\)$"):
        check_range("x", 1.5, 0.0, 1.0, hint="use less")


def test_number_sequences_are_converted():
    assert check_named_numbers("x", [1, 2.5], ("low", "high")) == (1.0, 2.5)
    assert check_named_numbers("x", np.array([1, 2]), ("low", "high")) == (1.0, 2.0)
    assert check_named_numbers("x", (v for v in (1, 2)), ("low", "high")) == (1.0, 2.0)


@pytest.mark.parametrize("value", [(1,), (1, 2, 3), "12", b"12", 7, None])
def test_sequences_of_another_length_are_rejected(value):
    with pytest.raises(ValueError, match=r"^x = .*must be 2 numbers \(low, high\)"):
        check_named_numbers("x", value, ("low", "high"))


def test_the_invalid_element_of_a_sequence_is_named():
    with pytest.raises(ValueError, match=r"^x \(high\) = 'y'"):
        check_named_numbers("x", (1, "y"), ("low", "high"))


def test_choices_are_checked():
    assert check_choice("x", "b", ["b", "a"]) == "b"
    with pytest.raises(ValueError, match=r"^x = 'lobbe': must be one of lobe, mirrored \(did you"):
        check_choice("x", "lobbe", ["mirrored", "lobe"])
    with pytest.raises(ValueError, match=r"^x = 3: must be one of a, b$"):
        check_choice("x", 3, ["b", "a"])


def test_suggestions_require_similar_names():
    assert suggest_name("saturaton", ["density", "saturation"]) == "did you mean saturation?"
    assert suggest_name("qqq", ["density", "saturation"]) == ""
    assert suggest_name(7, ["density"]) == ""


def test_suggestions_explain_angles_under_other_names():
    names = ["polar_deg", "azimuth_deg"]
    for given in ("vza", "view_zenith", "VIEW_ZENITH_deg"):
        assert suggest_name(given, names) == "did you mean polar_deg?"
    for given in ("raa", "relative_azimuth_deg"):
        assert suggest_name(given, names) == (
            "did you mean azimuth_deg? "
            "azimuth_deg is 180 minus a relative azimuth that is 0 on the side of the sun"
        )
    assert suggest_name("azimut_deg", names) == "did you mean azimuth_deg?"
    assert suggest_name("sza", ["incidence_deg"]) == "did you mean incidence_deg?"
    for given in ("sza", "incidence_deg"):
        assert suggest_name(given, names) == (
            "incidence_deg is an argument of instruments, and of tables with this axis"
        )


def test_errors_keep_their_attributes():
    error = invalid("depth_m", -1.0, "above 0", "in metres")
    assert (error.key, error.value, error.allowed) == ("depth_m", -1.0, "above 0")
    prefixed = pickle.loads(pickle.dumps(error)).add_prefix("medium", "not in cm")
    assert str(prefixed) == "medium.depth_m = -1.0: must be above 0 (in metres) (not in cm)"
    missing = unknown_key("depth", ["depth_m"]).add_prefix("medium")
    assert isinstance(missing, ValueError)
    assert str(missing) == (
        "medium.depth: unknown key, must be one of depth_m (did you mean depth_m?)"
    )
