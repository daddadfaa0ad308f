"""A ray that crosses one interface after another, for tests in either precision.

    NUMBA_DISABLE_JIT=1 python interface_events.py EVENTS

prints the largest errors in single precision.  The compiled kernels trace polarization in double
precision only; as plain Python their functions keep the precision of their arguments.
"""

import sys

import numpy as np

from splits.kernels.arithmetic import (
    dot,
    make_tangents,
    normalize,
    scale,
)
from splits.kernels.interface import ComplexIndex, sample_polarized_interface
from splits.kernels.rng import start_stream, uniform
from splits.kernels.scene import Stokes, Vector

INDEX = 1.31


def to_precision(value, real):
    """Return a named tuple of numbers in a precision."""
    return type(value)(*(real(x) for x in value))


def follow_interfaces(n_events: int, real: type) -> dict[str, float]:
    """Return the largest errors of fully polarized light at interfaces of random orientation."""
    state = np.zeros(1, dtype=np.uint64)
    start_stream(state, 9, 0, 0)
    d = to_precision(Vector(0.0, 0.6, 0.8), real)
    e = to_precision(make_tangents(d).u, real)
    stokes = Stokes(e, real(0.6), real(-0.48), real(0.64))
    media = [ComplexIndex(real(n), real(0.0)) for n in (1.0, INDEX)]
    errors = dict.fromkeys(("degree", "length", "direction", "angle"), 0.0)
    inside = 0
    for _ in range(n_events):
        normal = normalize(Vector(*(real(uniform(state) - 0.5) for _ in range(3))))
        normal = scale(real(-1.0 if dot(d, normal) > 0.0 else 1.0), normal)
        sample = sample_polarized_interface(
            state, d, stokes, normal, media[inside], media[1 - inside]
        )
        d, stokes = sample.direction, sample.stokes
        assert all(type(x) is real for x in (*d, *stokes.e, *stokes[1:]))
        inside = 1 - inside if sample.transmitted else inside
        exact_d, exact_e, polarization = (
            np.array(x, dtype=float) for x in (d, stokes.e, stokes[1:])
        )
        for name, error in (
            ("degree", np.linalg.norm(polarization) - 1.0),
            ("length", np.linalg.norm(exact_e) - 1.0),
            ("direction", np.linalg.norm(exact_d) - 1.0),
            ("angle", exact_e @ exact_d),
        ):
            errors[name] = max(errors[name], abs(float(error)))
    return errors


if __name__ == "__main__":
    np.seterr(over="ignore")
    for name, error in follow_interfaces(int(sys.argv[1]), np.float32).items():
        print(name, error)
