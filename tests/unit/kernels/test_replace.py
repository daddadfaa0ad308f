"""Named tuples with replaced fields: the same in kernels as in Python."""

from typing import Any, NamedTuple

from chi2 import NEEDS_JIT
from numba import njit

from splits.kernels.arithmetic import Vector
from splits.kernels.compiler.jit import replace


class Particle(NamedTuple):
    status: int
    position: Vector
    direction: Vector
    weight: float
    light: Any


PARTICLE = Particle(0, Vector(1.0, 2.0, 3.0), Vector(0.0, 0.0, 1.0), 1.0, None)
OTHER = Vector(-1.0, 0.0, 0.5)


def change(particle, other):
    """Return the particle after changes of one field, of fields in another order, and of none."""
    moved = replace(particle, position=other)
    turned = replace(particle, direction=other)
    halved = replace(turned, weight=0.5 * turned.weight, status=turned.status + 1)
    return moved, turned, halved, replace(halved)


def test_other_fields_are_kept():
    moved, turned, halved, same = change(PARTICLE, OTHER)
    assert moved == PARTICLE._replace(position=OTHER)
    assert turned == PARTICLE._replace(direction=OTHER)
    assert halved == same == turned._replace(weight=0.5, status=1)


@NEEDS_JIT
def test_kernels_return_the_same():
    # Numba finds compiled code by the types of arguments: position and direction have the same.
    assert njit(change)(PARTICLE, OTHER) == change(PARTICLE, OTHER)


@NEEDS_JIT
def test_a_field_may_change_in_a_loop():
    @njit
    def halve(particle, n):
        for _ in range(n):
            particle = replace(particle, weight=0.5 * particle.weight)
        return particle

    assert halve(PARTICLE, 3) == PARTICLE._replace(weight=0.125)
