"""Versions of inlined functions for named tuples of other classes, as for other grain shapes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from numba import njit
from numba.core.errors import TypingError

from splits.kernels.base.scene import make_bounding_optics
from splits.kernels.compiler.jit import inline, inline_only, specialize
from splits.kernels.grains.population import GrainTypes
from splits.kernels.vectorized.eligibility import select_features
from splits.media import Snow
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


def test_other_shapes_are_traced_by_the_scalar_kernel():
    class OtherTypes(NamedTuple):
        n_shells: np.ndarray

    snow = Snow(depth_m=0.02)
    scene = build_scene(snow, 0.0, False)
    index, absorption = compute_optical_constants(snow, np.array([900.0]))
    optics = make_bounding_optics(index[0], absorption)
    assert isinstance(scene.types, GrainTypes)
    assert select_features(scene, optics) is not None
    other = scene._replace(types=OtherTypes(scene.types.n_shells))
    assert select_features(other, optics) is None
