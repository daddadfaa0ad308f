"""Stacks: valid and invalid layers, and their description."""

from __future__ import annotations

import numpy as np
import pytest

import splits
from splits.media.interpretations import INTERPRETATION_SETS
from splits.media.kinds import check_medium
from splits.simulation.scene import build_scene
from splits.simulation.spectral_nodes import choose_nodes

FRESH_SNOW = splits.Snow(grain_size_um=(50, 100), density_kg_m3=120, saturation=0.0, depth_m=0.02)
SAND = splits.Sand(hematite_ratio=0.5, magnetite=0.05, depth_m=0.1)


@pytest.mark.parametrize(
    ("layers", "message"),
    [
        ([], "1 to 200"),
        (FRESH_SNOW, "a list of media, top first"),
        ("snow", "a list of media, top first"),
        ([FRESH_SNOW, 3], r"layers\[1\] = 3: must be splits.Snow"),
        ([FRESH_SNOW, splits.Snow], r"layers\[1\]"),
        ([FRESH_SNOW, splits.RoughSurface], r"layers\[1\]"),
        (
            [FRESH_SNOW, splits.Snow(interpretation={"entry_point": "projected"})],
            r"layers\[1\].interpretation .*those of layers\[0\]",
        ),
    ],
)
def test_invalid_layers_are_rejected_by_number(layers, message):
    with pytest.raises(ValueError, match=message):
        splits.Stack(layers)


@pytest.mark.parametrize(
    "medium",
    [
        splits.Snow(depth_m=0.0005),
        splits.Sand(depth_m=0.002),
        splits.Stack([splits.Snow(depth_m=0.0003), splits.Snow(depth_m=0.0004)]),
    ],
)
def test_samples_thinner_than_a_grain_are_rejected(medium):
    with pytest.raises(ValueError, match=r"depth_m = .*more than the largest grain"):
        check_medium(medium)


def test_thin_layers_are_accepted_in_a_thick_stack():
    check_medium(splits.Stack([splits.Snow(depth_m=1e-7), splits.Snow()]))


def test_layers_keep_order_types_and_materials():
    stack = splits.Stack([FRESH_SNOW, SAND, splits.Snow()], interpretation="splits_2007")
    scene = build_scene(stack, 30.0, False)
    assert scene.layers.boundaries == pytest.approx([0.0, -0.02, -0.12, -0.24])
    assert stack.depth_m == pytest.approx(0.24)
    sand = SAND.make_grain_population()
    n_types = len(sand.type_cdf)
    assert list(scene.layers.first_type) == [0, 1, 1 + n_types]
    assert np.all(scene.layers.type_cdf[0] == 1.0)
    assert np.array_equal(scene.layers.type_cdf[1], sand.type_cdf)
    assert all(table.flags.c_contiguous for table in scene.types)
    names = stack.list_materials()
    assert names[:3] == ("layers.0.air", "layers.0.water", "layers.0.ice")
    for number, medium in enumerate(stack.layers):
        first, pore = scene.layers.first_type[number], scene.layers.first_pore_material[number]
        types = medium.make_grain_population().types
        for grain_type, shells in enumerate(types.n_shells):
            assert scene.types.n_shells[first + grain_type] == shells
            for shell in range(shells):
                row = scene.types.material[first + grain_type, shell]
                material = medium.list_materials()[types.material[grain_type, shell]]
                assert names[row] == f"layers.{number}.{material}"
        assert names[pore] == f"layers.{number}.{medium.list_materials()[0]}"
    wavelengths = np.array([450.0, 900.0])
    index = stack.compute_refractive_indices(wavelengths)
    assert index.shape == (2, len(names))
    assert np.array_equal(index[:, :3], FRESH_SNOW.compute_refractive_indices(wavelengths))


def test_interpolation_bound_covers_every_layer():
    wavelengths = np.arange(400.0, 1001.0, 20.0)
    for order in ([FRESH_SNOW, SAND], [SAND, FRESH_SNOW]):
        stack = splits.Stack(order, interpretation="splits_2007")
        nodes = choose_nodes(
            stack.compute_refractive_indices(wavelengths), stack.list_interfaces(), 1e-3
        )
        single = choose_nodes(
            SAND.compute_refractive_indices(wavelengths), SAND.list_interfaces(), 1e-3
        )
        assert len(nodes.index) >= len(single.index)
        assert nodes.interpolation_bound.max() <= 1e-3


def test_description_contains_all_inputs():
    attributes = splits.Stack([FRESH_SNOW, splits.Snow()]).describe()
    assert attributes["layers_0_grain_size_um"] == (50.0, 100.0)
    assert attributes["layers_1_grain_size_um"] == (300.0, 750.0)
    assert attributes["layers_1_kind"] == "snow"


@pytest.mark.parametrize("above", [True, False])
def test_wet_pores_have_boundaries_with_particle_matrices(above):
    layer = splits.ParticleLayer(refractive_index=1.5, depth_m=0.01, bottom_albedo=None)
    snow = splits.Snow(saturation=0.25)
    stack = splits.Stack([layer, snow] if above else [snow, layer])
    names = stack.list_materials()
    boundaries = [i for i in stack.list_interfaces() if i.location == "boundary"]
    named = {(names[i.outer_material], names[i.inner_material], i.fraction) for i in boundaries}
    assert (f"layers.{1 - above}.matrix", f"layers.{1 * above}.water", 0.25) in named


def test_a_named_set_replaces_the_interpretation_of_layers():
    natural = splits.Snow.natural(optical_radius_um=100, depth_m=0.1)
    for name in INTERPRETATION_SETS:
        (layer,) = splits.Stack([natural], interpretation=name).scene_layers
        assert layer.interpretation == splits.Interpretation.from_input(name)


def test_layers_must_have_the_same_free_path_model():
    snow = {"optical_radius_um": 100, "depth_m": 0.1}
    other = splits.Snow.natural(**snow, interpretation={"mean_free_path": "pore_only"})
    with pytest.raises(ValueError, match=r"layers\[1\].interpretation"):
        splits.Stack([splits.Snow.natural(**snow), other])


def test_incompatible_attenuation_factor_is_rejected():
    message = "attenuation_factor = 'as_printed': must be solid_fraction"
    with pytest.raises(ValueError, match=message):
        splits.Sand(
            interpretation={"set": "radiative_transfer", "attenuation_factor": "as_printed"}
        )
