"""Path signatures: every field of a scene distinguishes media, except for a length scale."""

from __future__ import annotations

import math

import numpy as np
import pytest

import splits
from splits.kernels.scene import Scene
from splits.simulation import shared_paths
from splits.simulation.scene import build_scene
from splits.simulation.shared_paths import compute_path_signature

GRAINS_AND_PARTICLES = splits.Stack(
    [
        splits.ParticleLayer(optical_thickness=1.0, bottom_albedo=None),
        splits.Snow(depth_m=0.1, pores={"oil": 0.1}, refractive_index={"oil": 1.4}),
    ]
)
INFINITE = {"specific_surface_area_m2_kg": 20.0, "depth_m": math.inf}


def alter(value):
    """Yield named tuples with one field altered, or another value."""
    if hasattr(value, "_fields"):
        for name, item in zip(value._fields, value, strict=True):
            for other in alter(item):
                yield value._replace(**{name: other})
    else:
        yield 0.5 if value is None else np.asarray(value) + 1


@pytest.mark.parametrize("field", Scene._fields)
def test_every_field_of_a_scene_enters_the_signature(monkeypatch, field):
    scene = build_scene(GRAINS_AND_PARTICLES, 0.0, False)
    signature = compute_path_signature(GRAINS_AND_PARTICLES)
    for other in alter(getattr(scene, field)):
        altered = scene._replace(**{field: other})
        monkeypatch.setattr(shared_paths, "build_scene", lambda *_, altered=altered: altered)
        assert compute_path_signature(GRAINS_AND_PARTICLES)[0] != signature[0]


def test_the_ground_below_a_finite_layer_is_part_of_its_signature():
    finite = INFINITE | {"depth_m": 1.0}
    over_soil = splits.Snow.natural(**finite, ground=0.3)
    assert compute_path_signature(over_soil) != compute_path_signature(
        splits.Snow.natural(**finite)
    )


def test_lengths_count_in_mean_free_paths():
    coarse, fine = (
        compute_path_signature(splits.Snow.natural(specific_surface_area_m2_kg=area, depth_m=depth))
        for area, depth in ((20.0, 0.1), (40.0, 0.05))
    )
    assert coarse[0] == fine[0]
    assert coarse[1] == pytest.approx(2.0 * fine[1])


@pytest.mark.parametrize("altered", [{"refractive_index": 1.4}, {"polarized": True}])
def test_particles_and_their_matrix_must_be_the_same(altered):
    plain, other = splits.ParticleLayer(), splits.ParticleLayer(**altered)
    assert compute_path_signature(plain) != compute_path_signature(other)
