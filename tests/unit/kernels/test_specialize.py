"""Versions of inlined functions for named tuples of other classes, as for other grain shapes."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compare_results
from numba import njit
from numba.core.errors import TypingError

import splits
from splits.kernels.arithmetic import (
    Angle,
    add_scaled,
    direction_around,
    dot,
    normalize,
)
from splits.kernels.compiler import cache
from splits.kernels.compiler.jit import inline, inline_only, specialize
from splits.kernels.grains import grain_path, spheroid
from splits.kernels.grains.grain_path import GrainSample
from splits.kernels.grains.spheroid import Chord
from splits.kernels.rng import interpolate_quantile, sample_azimuth, uniform
from splits.kernels.scene import UP, Vector, make_bounding_optics
from splits.kernels.vectorized.trace import select_features
from splits.media import ParticleLayer, Snow, Stack
from splits.simulation.scene import build_scene, compute_optical_constants

pytestmark = NEEDS_JIT


class Disk(NamedTuple):
    radius: float


class Rectangle(NamedTuple):
    width: float
    height: float


class Triangle(NamedTuple):
    base: float


@inline
def compute_area(shape):
    return 3.0 * shape.radius * shape.radius


@inline_only
def compute_double_area(scale, shape):
    return scale * 2.0 * compute_area(shape)


@specialize(compute_area, Rectangle)
def compute_rectangle_area(shape):
    return shape.width * shape.height


@njit
def measure(shape):
    return compute_double_area(1.0, shape)


def test_the_class_of_an_argument_selects_the_version():
    assert measure(Disk(1.0)) == 6.0
    assert measure(Rectangle(2.0, 5.0)) == 20.0
    assert compute_area(Disk(2.0)) == 12.0


def test_classes_without_a_version_do_not_compile():
    with pytest.raises(TypingError):
        measure(Triangle(1.0))


class BallTypes(NamedTuple):
    n_shells: np.ndarray
    material: np.ndarray
    coating_thickness: np.ndarray
    inverse_semi_major: np.ndarray


class BallSize(NamedTuple):
    semi_major: float


class BallVariates(NamedTuple):
    u_cos_incidence: float
    azimuth: Angle


class Ball(NamedTuple):
    normal: Vector
    radius: float


class BallEntry(NamedTuple):
    grain: Ball
    normal: Vector


PLACEHOLDER = (GrainSample(0, BallSize(1.0), 0.0), BallEntry(Ball(UP, 1.0), UP))


@specialize(grain_path.sample_shape, BallTypes)
def sample_ball(state, types, grain_type):
    radius = 1.0 / interpolate_quantile(types.inverse_semi_major, grain_type, uniform(state))
    return GrainSample(grain_type, BallSize(radius), 0.0)


@specialize(grain_path.make_placeholder_grain, BallTypes)
def make_placeholder_ball(types):
    return PLACEHOLDER


@specialize(grain_path.sample_entry_variates, BallSize)
def sample_ball_variates(state, size):
    return BallVariates(uniform(state), sample_azimuth(state))


@specialize(spheroid.sample_entry_point, BallSize)
def sample_ball_entry(d, size, variates, entry_sampling):
    polar = Angle(math.sqrt(variates.u_cos_incidence), math.sqrt(1.0 - variates.u_cos_incidence))
    normal = direction_around(Vector(-d.x, -d.y, -d.z), polar, variates.azimuth)
    return BallEntry(Ball(normal, size.semi_major), normal)


@specialize(spheroid.overlaps_boundary, BallEntry)
def overlaps_boundary_with_ball(entry, height, bottom, top):
    radius = entry.grain.radius
    centre = height - radius * entry.grain.normal.z
    return (centre + radius > top) | (centre - radius < bottom)


@specialize(spheroid.overlaps_segment, Ball)
def overlaps_segment_with_ball(grain, segment):
    a = add_scaled(grain.radius, grain.normal, segment.end)
    t = min(max(dot(a, segment.direction), 0.0), segment.length)
    a = add_scaled(-t, segment.direction, a)
    return (segment.length > 0.0) & (dot(a, a) < grain.radius * grain.radius)


@specialize(spheroid.compute_outward_normal, Ball)
def compute_ball_normal(grain):
    return grain.normal


@specialize(spheroid.compute_chord, Ball)
def compute_ball_chord(grain, d):
    chord = max(-2.0 * dot(grain.normal, d), 0.0)
    normal = normalize(add_scaled(chord, d, grain.normal))
    return Chord(chord * grain.radius, Ball(normal, grain.radius))


class BallSnow(Snow):
    def make_grain_population(self):
        population = super().make_grain_population()
        tables = [getattr(population.types, name) for name in BallTypes._fields]
        return population._replace(types=BallTypes(*tables))


SPHERES = {
    "sphericity": (1.0, 1.0, 1.0, 0.0), "facetness": (0.0, 0.0, 0.0, 0.0), "depth_m": 0.002,
    "interpretation": {"entry_point": "projected"},
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("above", [None, ParticleLayer(optical_thickness=0.3, ground=None)])
def test_another_shape_is_traced_alone_and_in_stacks(above, monkeypatch, tmp_path):
    """Balls, and spheroids that are spheres, reflect the same."""
    # The digest of the cached kernels does not cover the versions in this file.
    monkeypatch.setattr(cache, "find_cache_folder", lambda: tmp_path)
    spheres = [make(**SPHERES) for make in (BallSnow, Snow)]
    media = spheres if above is None else [Stack([above, one]) for one in spheres]
    balls, spheroids = (
        splits.spectrophotometer(one, [900.0], max_stderr=0.004, kernel="scalar") for one in media
    )
    assert abs(compare_results(balls, spheroids, "reflectance")) < 4.0


def test_layers_of_several_shapes():
    layers = [BallSnow(**SPHERES), BallSnow(**SPHERES)]
    scene = build_scene(Stack(layers), 0.0, False)
    assert isinstance(scene.types, BallTypes)
    assert scene.types.inverse_semi_major.shape[0] == scene.types.n_shells.size == 2
    with pytest.raises(ValueError, match="one shape"):
        build_scene(Stack([*layers, Snow(**SPHERES)]), 0.0, False)


def test_other_shapes_are_traced_by_the_scalar_kernel():
    scene = build_scene(BallSnow(**SPHERES), 0.0, False)
    index, absorption = compute_optical_constants(Snow(**SPHERES), np.array([900.0]))
    assert select_features(scene, make_bounding_optics(index[0], absorption)) is None
