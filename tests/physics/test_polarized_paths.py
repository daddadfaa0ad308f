"""Polarization of single rays after every event, and after a hundred thousand of them.

The loops over events of the kernels run as plain Python here, so that every event can be followed.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys

import interface_events
import numpy as np
import pytest
from chi2 import NEEDS_JIT, scale_sample_size
from interface_events import follow_interfaces
from numba import njit
from scenes import compute_optics

import splits
from splits.kernels.arithmetic import (
    ORIGIN,
    UP,
    Vector,
    dot,
)
from splits.kernels.grains import grain_path
from splits.kernels.grains.grain_path import (
    sample_entry_variates,
    sample_grain,
    trace_through_grain,
)
from splits.kernels.grains.spheroid import sample_entry_point
from splits.kernels.rng import start_stream
from splits.kernels.rough_surface.realization import (
    allocate_realization,
    sample_realization_if_rough,
)
from splits.kernels.scene import NO_MAX_ORDER, make_bounding_optics, make_ray
from splits.kernels.stokes import Stokes, make_tangents
from splits.kernels.transport import events, history
from splits.simulation.scene import IncidentPolarization, build_scene, compute_optical_constants

EPSILON = 2.0**-52
N_EVENTS = 100_000
WAVES = {"rms_height_m": 0.01, "wave_number_per_m": 20.0, "correlation": "gaussian"}
LAYER = {"optical_thickness": 2.0, "single_scattering_albedo": 0.99, "polarized": True}
MEDIA = {
    "snow": splits.Snow(depth_m=0.002, saturation=0.2),
    "mirrored snow": splits.Snow(depth_m=0.002, interpretation={"wrong_side_ray": "mirror"}),
    "sand": splits.Sand(depth_m=0.002, partition=(0.0, 0.5, 0.5)),
    "particles": splits.ParticleLayer(**LAYER, phase_function="rayleigh"),
    "rough": splits.ParticleLayer(**LAYER, asymmetry=0.7, surface=WAVES),
    "stack": splits.Stack(
        [
            splits.ParticleLayer(**LAYER, depth_m=0.1, bottom_albedo=None),
            splits.Snow(depth_m=0.002),
        ],
        ground=0.5,
    ),
}
EVENTS = (
    (grain_path, "sample_interaction"), (events, "reflect_or_refract_ray"),
    (events, "sample_scattering"),
)  # fmt: skip
"""Functions of the kernels that change the polarization of a ray, by the module that calls them."""


def watch_events(monkeypatch) -> list[tuple[str, float, float, float]]:
    """Return a list that is filled with events: degree of polarization − 1, and errors of frames.

    The errors are those of the length of the reference, and of its angle with the direction, the
    larger one of before and after the event.
    """
    watched: list[tuple[str, float, float, float]] = []

    def watch(module, name):
        function = getattr(module, name)

        def wrapped(*arguments):
            # The direction of travel is the first vector of all events.
            before = next(x for x in arguments if isinstance(x, Vector))
            light = next(x for x in arguments if isinstance(x, Stokes))
            out = function(*arguments)
            if hasattr(out, "result") and not out.result.accepted:
                # The ray has neither moved nor changed, and interacts again.
                return out
            direction = out.result.direction if hasattr(out, "result") else out.direction
            e, q, u, v = out.stokes
            angle = max(abs(dot(e, direction)), abs(dot(light.e, before)))
            degree = math.sqrt(q * q + u * u + v * v)
            watched.append((name, degree - 1.0, dot(e, e) - 1.0, angle))
            return out

        monkeypatch.setattr(module, name, wrapped)

    for module, name in EVENTS:
        watch(module, name)
    return watched


@pytest.mark.parametrize("name", MEDIA)
def test_no_event_polarizes_light_by_more_than_its_intensity(name, monkeypatch):
    """q² + u² + v² ≤ 1, and an orthonormal frame, after every event of some rays."""
    medium = MEDIA[name]
    scene = build_scene(medium, 50.0, False, IncidentPolarization())
    constants = compute_optical_constants(medium, np.array([600.0]))
    optics = make_bounding_optics(constants.indices[0], constants.absorption)
    watched = watch_events(monkeypatch)
    path_lengths, state = np.zeros(optics.n.size), np.zeros(1, dtype=np.uint64)
    fields = scene.height_fields
    buffer = None if fields is None else allocate_realization(fields)
    number = 0
    while len(watched) < 1500:
        start_stream(state, 3, 0, number)
        surface = None
        if fields is not None:
            surface = sample_realization_if_rough(state, fields, buffer)
        history.trace_ray(state, scene, optics, path_lengths, None, surface, NO_MAX_ORDER)
        number += 1
    names = {event[0] for event in watched}
    degree, length, angle = np.array([event[1:] for event in watched]).T
    print(
        f"{name}: {number} rays, {len(watched)} events of {sorted(names)}, degree - 1 up to "
        f"{degree.max():.1e}, frame {np.abs(length).max():.1e}, {np.abs(angle).max():.1e}"
    )
    assert degree.max() <= 4.0 * EPSILON
    assert np.abs(length).max() < 16.0 * EPSILON
    assert np.abs(angle).max() < 16.0 * EPSILON
    # Most events polarize light.
    assert (degree > -1.0).mean() > 0.5


@njit
def _follow_grains(count, light, scene, optics, path_lengths):
    """Return the largest errors of a fully polarized ray that hits one grain after another.

    Errors of the degree of polarization, of the lengths of the reference and of the direction, and
    of their angle.
    """
    state = np.zeros(1, dtype=np.uint64)
    start_stream(state, 5, 0, 0)
    d, errors = UP, np.zeros(4)
    stokes = Stokes(make_tangents(d).u, light[0], light[1], light[2])
    for _ in range(count):
        grain = sample_grain(state, scene, 0)
        variates = sample_entry_variates(state, grain.size)
        entry = sample_entry_point(d, grain.size, variates, scene.rules.entry_sampling)
        ray = make_ray(ORIGIN, d, stokes, 1.0, np.inf, NO_MAX_ORDER)
        ray = trace_through_grain(state, ray, grain, entry, scene, optics, path_lengths)
        d, stokes = ray.direction, ray.stokes
        degree = np.sqrt(stokes.q**2 + stokes.u**2 + stokes.v**2)
        errors[0] = max(errors[0], abs(degree - 1.0))
        errors[1] = max(errors[1], abs(dot(stokes.e, stokes.e) - 1.0))
        errors[2] = max(errors[2], abs(dot(d, d) - 1.0))
        errors[3] = max(errors[3], abs(dot(stokes.e, d)))
    return errors


@NEEDS_JIT
@pytest.mark.parametrize("light", [(0.6, -0.48, 0.64), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)], ids=str)
@pytest.mark.parametrize("facetness", [0.0, 0.4])
def test_fully_polarized_light_stays_so_through_grains(light, facetness):
    """Without absorption and lobes, reflection and refraction keep the degree of polarization."""
    medium = splits.Snow(
        facetness=(facetness, facetness, facetness, 0.0), saturation=0.0,
        refractive_index={"ice": 1.31}, interpretation={"wrong_side_ray": "mirror"},
    )  # fmt: skip
    scene, optics = (
        build_scene(medium, 0.0, False, IncidentPolarization()),
        compute_optics(medium, 600.0),
    )
    # A ray that hits a grain has one event at least.
    errors = _follow_grains(N_EVENTS, np.array(light), scene, optics, np.zeros(optics.n.size))
    print(f"facetness {facetness}, {N_EVENTS} grains: errors {errors}")
    # Rounding errors of the degree add up as a random walk; those of frames do not add up.
    assert errors[0] < 4.0 * EPSILON * math.sqrt(N_EVENTS)
    assert (errors[1:] < 16.0 * EPSILON).all()


def test_fully_polarized_light_stays_so_at_interfaces_in_double_precision():
    errors = follow_interfaces(scale_sample_size(N_EVENTS), float)
    print(f"double precision: {errors}")
    assert errors["degree"] < 4.0 * EPSILON * math.sqrt(N_EVENTS)
    assert max(errors["length"], errors["direction"], errors["angle"]) < 16.0 * EPSILON


def test_fully_polarized_light_stays_so_at_interfaces_in_single_precision():
    """Compiled kernels have polarization in double precision only: this is plain Python."""
    out = subprocess.run(
        [sys.executable, interface_events.__file__, str(N_EVENTS)],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    errors = {name: float(value) for name, value in map(str.split, out.stdout.splitlines())}
    print(f"single precision: {errors}")
    epsilon = float(np.finfo(np.float32).eps)
    assert errors["degree"] < 4.0 * epsilon * math.sqrt(N_EVENTS)
    assert max(errors["length"], errors["direction"], errors["angle"]) < 16.0 * epsilon
