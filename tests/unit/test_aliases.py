"""Equivalent parameters given twice are rejected."""

from __future__ import annotations

import pytest
from array_inputs import FIXED, SIZE, SOOT, TABLE
from formula_tables import W, evaluate_spectrum, make_table

import splits
from splits.core.validation import InvalidValue
from splits.experiments.config.experiment import ExperimentConfig
from splits.retrieval.medium_model import check_measurement_incidence, make_medium_state_vector
from splits.tables.conversions import convert_to_isofit

BOTH_SPELLINGS = {"sza": 30.0, "incidence_deg": 50.0}
POINT = {SIZE: 100.0, SOOT: 64.0}
MEASURED = (W, evaluate_spectrum(200.0, 64.0))
SNOW = splits.Snow.natural(specific_surface_area_m2_kg=20)
ANGLE_TABLE = make_table(
    lambda size, angle, _: evaluate_spectrum(size, 0.0),
    {SIZE: [50.0, 100.0], "incidence_deg": [0.0, 60.0], "depth_m": [1.0, 2.0]},
).dataset

GIVEN_TWICE = {
    "interp": lambda: TABLE.interp(**POINT, **BOTH_SPELLINGS),
    "derivatives": lambda: TABLE.derivatives([SIZE], **POINT, **BOTH_SPELLINGS),
    "interpolation_errors": lambda: TABLE.interpolation_errors("reflectance", **POINT,
                                                               **BOTH_SPELLINGS),
    "retrieve": lambda: splits.retrieve(MEASURED, TABLE, [SIZE], 0.1,
                                        fixed={SOOT: 64.0} | BOTH_SPELLINGS),
    "fixed of a medium": lambda: check_measurement_incidence(BOTH_SPELLINGS, {}),
    "table": lambda: splits.build_table(
        splits.Snow.natural, {SIZE: [100, 200], "incidence_deg": [0, 60]}, [500], 30.0
    ),
    "experiment": lambda: ExperimentConfig(
        name="made", medium={"kind": "snow"}, grid={"incidence_deg": [0, 60]},
        instrument={"wavelength_nm": [500], "incidence_deg": 30},
    ),
    "Snow": lambda: splits.Snow(saturation=0.1, liquid_water_content=0.1),
    "Snow.natural": lambda: splits.Snow.natural(
        specific_surface_area_m2_kg=20, optical_radius_um=100
    ),
    "free": lambda: make_medium_state_vector(
        SNOW, {SIZE: (50, 500), "specific_surface_area_m2_kg": (5, 50)}, None, 0.0
    ),
    "free of a layer": lambda: make_medium_state_vector(
        splits.Stack([SNOW]),
        {"layers.0.saturation": (0, 0.2), "layers.0.liquid_water_content": (0, 0.1)}, None, 0.0,
    ),
}  # fmt: skip
IGNORED_ALIASES = {
    "interpolation_errors": lambda: TABLE.interpolation_errors("reflectance", **POINT, szaa=3),
    "isofit": lambda: convert_to_isofit(ANGLE_TABLE, depth=1.0),
    "isofit free": lambda: convert_to_isofit(ANGLE_TABLE, depth_m=1.0, incidence_deg=30.0),
}


@pytest.mark.parametrize("name", GIVEN_TWICE)
def test_parameters_given_twice_are_rejected(name):
    with pytest.raises(ValueError, match=r"left out(, because| where)"):
        GIVEN_TWICE[name]()


@pytest.mark.parametrize("name", IGNORED_ALIASES)
def test_keywords_without_effect_are_rejected(name):
    with pytest.raises(InvalidValue, match=r"unknown key|left out, as it is free"):
        IGNORED_ALIASES[name]()


def test_aliases_are_accepted_for_all_axes():
    full_name, alias = {"incidence_deg": 30.0}, {"sza": 30.0}
    for evaluate in (
        lambda angle: TABLE.interp(**POINT, **angle).reflectance,
        lambda angle: TABLE.derivatives([SIZE], **POINT, **angle).reflectance_jacobian,
        lambda angle: TABLE.interpolation_errors("reflectance", **POINT, **angle),
        lambda angle: (
            splits.retrieve(MEASURED, TABLE, [SIZE], 0.1, fixed={SOOT: 64.0} | angle).dataset.value
        ),
    ):
        assert (abs(evaluate(full_name) - evaluate(alias)) == 0.0).all()
    assert FIXED["incidence_deg"] == 30.0


def test_equivalent_parameters_of_two_layers_are_accepted():
    stack = splits.Stack([splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.1), SNOW])
    ranges = {"layers.0.saturation": (0, 0.2), "layers.1.liquid_water_content": (0, 0.1)}
    assert make_medium_state_vector(stack, ranges, None, 0.0).names == tuple(ranges)
