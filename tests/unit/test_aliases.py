"""One thing under two names: refused wherever it can be given."""

from __future__ import annotations

import pytest
from array_inputs import AT, DIRT, SIZE, TABLE
from formula_tables import W, spectrum, table_of

import splits
from splits.checks import Refusal
from splits.experiments.model import Experiment
from splits.lookup.formats import for_spires
from splits.lookup.isofit import for_isofit
from splits.retrieval.media import free_of, incidence_of

BOTH = {"sza": 30.0, "incidence_deg": 50.0}
PLACE = {SIZE: 100.0, DIRT: 64.0}
SEEN = (W, spectrum(200.0, 64.0))
SNOW = splits.Snow.natural(specific_surface_area_m2_kg=20)
HELD = table_of(
    lambda size, angle, _: spectrum(size, 0.0),
    {SIZE: [50.0, 100.0], "incidence_deg": [0.0, 60.0], "depth_m": [1.0, 2.0]},
).dataset

TWICE = {
    "interp": lambda: TABLE.interp(**PLACE, **BOTH),
    "derivatives": lambda: TABLE.derivatives([SIZE], **PLACE, **BOTH),
    "interpolation_errors": lambda: TABLE.interpolation_errors("reflectance", **PLACE, **BOTH),
    "retrieve": lambda: splits.retrieve(SEEN, TABLE, [SIZE], 0.1, at={DIRT: 64.0} | BOTH),
    "best_bands": lambda: splits.best_bands(TABLE, W, [SIZE], 0.1, at={DIRT: 64.0} | BOTH),
    "sobol_indices": lambda: splits.sobol_indices(TABLE, [SIZE, DIRT], at=BOTH),
    "at of a medium": lambda: incidence_of(BOTH, {}),
    "table": lambda: splits.table(
        splits.Snow.natural, {SIZE: [100, 200], "incidence_deg": [0, 60]}, [500], 30.0
    ),
    "experiment": lambda: Experiment(
        name="made", medium={"kind": "snow"}, grid={"incidence_deg": [0, 60]},
        instrument={"wavelength_nm": [500], "incidence_deg": 30},
    ),
    "Snow": lambda: splits.Snow(saturation=0.1, liquid_water_content=0.1),
    "Snow.natural": lambda: splits.Snow.natural(
        specific_surface_area_m2_kg=20, optical_radius_um=100
    ),
    "free": lambda: free_of(
        SNOW, {SIZE: (50, 500), "specific_surface_area_m2_kg": (5, 50)}, None, 0.0
    ),
    "free of a layer": lambda: free_of(
        splits.Stack([SNOW]),
        {"layers.0.saturation": (0, 0.2), "layers.0.liquid_water_content": (0, 0.1)}, None, 0.0,
    ),
}  # fmt: skip
IGNORED = {
    "interpolation_errors": lambda: TABLE.interpolation_errors("reflectance", **PLACE, szaa=3),
    "spires": lambda: for_spires(TABLE.dataset, DIRT, {"a": (600, 700)}, depth=3),
    "spires free": lambda: for_spires(TABLE.dataset, DIRT, {"a": (600, 700)}, sza=3),
    "isofit": lambda: for_isofit(HELD, depth=1.0),
    "isofit free": lambda: for_isofit(HELD, depth_m=1.0, incidence_deg=30.0),
}


@pytest.mark.parametrize("name", TWICE)
def test_one_thing_under_two_names_is_refused(name):
    with pytest.raises(ValueError, match=r"left out (beside|where)"):
        TWICE[name]()


@pytest.mark.parametrize("name", IGNORED)
def test_what_has_no_effect_is_refused(name):
    with pytest.raises(Refusal, match=r"unknown key|left out, as it is free"):
        IGNORED[name]()


def test_short_names_are_taken_wherever_axes_are():
    whole, short = {"incidence_deg": 30.0}, {"sza": 30.0}
    for look in (
        lambda at: TABLE.interp(**PLACE, **at).reflectance,
        lambda at: TABLE.derivatives([SIZE], **PLACE, **at).reflectance_jacobian,
        lambda at: TABLE.interpolation_errors("reflectance", **PLACE, **at),
        lambda at: splits.retrieve(SEEN, TABLE, [SIZE], 0.1, at={DIRT: 64.0} | at).dataset.value,
    ):
        assert (abs(look(whole) - look(short)) == 0.0).all()
    assert AT["incidence_deg"] == 30.0


def test_equal_things_of_two_layers_are_not_the_same():
    pack = splits.Stack([splits.Snow.natural(specific_surface_area_m2_kg=20, depth_m=0.1), SNOW])
    ranges = {"layers.0.saturation": (0, 0.2), "layers.1.liquid_water_content": (0, 0.1)}
    assert free_of(pack, ranges, None, 0.0).names == tuple(ranges)
