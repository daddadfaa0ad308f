"""Parameters replaced together, or one after another."""

import random

import pytest

import splits
from splits.media.parameters import list_parameters, replace_parameter, replace_parameters

VALUES = {
    "specific_surface_area_m2_kg": 30.0, "optical_radius_um": 200.0, "liquid_water_content": 0.03,
    "impurities_ng_g.black_carbon": 50.0, "impurities_ng_g.dust_sahara": 7.0,
    "density_kg_m3": 350.0, "depth_m": 0.2, "facetness": 0.1, "saturation": 0.1,
    "temperature_c": -5.0,
}  # fmt: skip


def make_snow():
    return splits.Snow.natural(
        specific_surface_area_m2_kg=20.0, depth_m=0.1, liquid_water_content=0.02,
        impurities_ng_g={"black_carbon": 5.0},
    )  # fmt: skip


def replace_in_turn(medium, values):
    for name, value in values.items():
        medium = replace_parameter(medium, name, value)
    return medium


@pytest.mark.parametrize("seed", range(30))
def test_parameters_of_snow_are_replaced_in_any_order(seed):
    names = random.Random(seed).sample(list(VALUES), 2 + seed % 6)
    values = {name: VALUES[name] for name in names}
    assert replace_parameters(make_snow(), values) == replace_in_turn(make_snow(), values)


@pytest.mark.parametrize("seed", range(10))
def test_parameters_of_stacks_are_replaced_in_any_order(seed):
    stack = splits.Stack([make_snow(), make_snow()], ground=0.3)
    names = [f"layers.{number}.{name}" for number in (0, 1) for name in VALUES]
    names = random.Random(seed).sample([*names, "ground"], 6)
    values = {name: VALUES.get(name.split(".", 2)[-1], 0.5) for name in names}
    assert replace_parameters(stack, values) == replace_in_turn(stack, values)


def test_fractions_keep_their_sum():
    sand = splits.Sand()
    values = {"partition.coated": 0.3, "partition.pure": 0.2}
    assert set(values) <= set(list_parameters(sand))
    changed = replace_parameters(sand, values)
    assert changed == replace_in_turn(sand, values)
    assert sum(changed.partition) == pytest.approx(1.0)
