"""Polarization of rays after every event, of plates, and laws of polarized light in media."""

import math
import os
import subprocess
import sys
from itertools import pairwise

import interface_events
import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z, scale_sample_size
from interface_events import follow_interfaces
from numba import njit
from scenes import compute_optics

import splits
from splits.kernels.arithmetic import dot
from splits.kernels.grains import grain_path
from splits.kernels.grains.grain_path import (
    sample_entry_variates,
    sample_grain,
    trace_through_grain,
)
from splits.kernels.grains.spheroid import FIRST_ROULETTE_DEPTH, sample_entry_point
from splits.kernels.rays import make_ray
from splits.kernels.rng import start_stream
from splits.kernels.rough_surface.realization import (
    allocate_realization,
    sample_realization_if_rough,
)
from splits.kernels.scene import (
    ALIVE,
    NO_MAX_ORDER,
    ORIGIN,
    REFLECTED,
    UP,
    Stokes,
    Vector,
    make_bounding_optics,
)
from splits.kernels.stokes import make_tangents, rotate_reference_to
from splits.kernels.transport import events, history
from splits.kernels.transport.events import enter_layer
from splits.kernels.transport.history import trace_history
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
            splits.ParticleLayer(**LAYER, depth_m=0.1, ground=None),
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


NM = [550.0]
LIGHT = {
    "unpolarized": (0.0, 0.0, 0.0), "parallel": (1.0, 0.0, 0.0), "perpendicular": (-1.0, 0.0, 0.0),
    "circular": (0.0, 0.0, 1.0), "elliptic": (0.48, -0.6, 0.64), "partial": (-0.2, 0.5, -0.3),
}  # fmt: skip
PLATES = {
    "glass": (1.5,), "diamond": (2.4,), "water on glass": (1.33, 1.6), "three": (1.6, 1.2, 1.9),
}  # fmt: skip
ANGLES = (20.0, 56.0, 80.0)


def make_plate(index: float, **more) -> splits.ParticleLayer:
    """Return a layer without particles."""
    return splits.ParticleLayer(
        optical_thickness=0.0, refractive_index=index, ground=None, polarized=True, **more
    )


def make_stack(indices: tuple[float, ...]) -> splits.ParticleLayer | splits.Stack:
    """Return plates without particles on top of each other."""
    plates = [make_plate(index) for index in indices]
    return plates[0] if len(plates) == 1 else splits.Stack(plates)


def compute_interface(n1: float, n2: float, sine: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the Mueller matrices of an interface by its amplitudes, for a sine in air.

    The reference of all beams is parallel to the plane of incidence.
    """
    w1, w2 = np.sqrt(n1**2 - sine**2 + 0j), np.sqrt(n2**2 - sine**2 + 0j)
    rs = (w1 - w2) / (w1 + w2)
    rp = (n2**2 * w1 - n1**2 * w2) / (n2**2 * w1 + n1**2 * w2)
    ts, tp = 2.0 * w1 / (w1 + w2), 2.0 * n1 * n2 * w1 / (n2**2 * w1 + n1**2 * w2)
    flux = (w2 / w1).real

    def make_mueller(p, s):
        plus, minus = 0.5 * (abs(p) ** 2 + abs(s) ** 2), 0.5 * (abs(p) ** 2 - abs(s) ** 2)
        product = p * np.conj(s)
        a, b = product.real, product.imag
        return np.array([[plus, minus, 0, 0], [minus, plus, 0, 0], [0, 0, a, b], [0, 0, -b, a]])

    return make_mueller(rp, rs), flux * make_mueller(tp, ts)


def add_interfaces(indices: tuple[float, ...], incidence_deg: float) -> tuple:
    """Return the matrices of reflection and transmission of plates in air, by addition.

    r and t are those of the plates so far for light from above, r_below and t_below from below.
    """
    sine = math.sin(math.radians(incidence_deg))
    media = [1.0, *indices, 1.0]
    r, t = compute_interface(media[0], media[1], sine)
    r_below, t_below = compute_interface(media[1], media[0], sine)
    for near, far in pairwise(media[1:]):
        next_r, next_t = compute_interface(near, far, sine)
        next_r_below, next_t_below = compute_interface(far, near, sine)
        down = np.linalg.inv(np.eye(4) - r_below @ next_r)
        up = np.linalg.inv(np.eye(4) - next_r @ r_below)
        r, t, r_below, t_below = (
            r + t_below @ next_r @ down @ t,
            next_t @ down @ t,
            next_r_below + next_t @ r_below @ up @ next_t_below,
            t_below @ up @ next_t_below,
        )
    return r, t


@njit
def _trace_light(seed, count, light, scene, optics, path_lengths):
    """Return sums over rays of I, Q, U and V, and of their squares, reflected and transmitted.

    Light has the reference in the plane of incidence, at both ends.
    """
    sums, state = np.zeros((2, 2, 4)), np.zeros(1, dtype=np.uint64)
    cosine = scene.source.cos_incidence
    sine = math.sqrt((1.0 - cosine) * (1.0 + cosine))
    d, e = Vector(sine, 0.0, -cosine), Vector(cosine, 0.0, sine)
    stokes = Stokes(e, light[0], light[1], light[2])
    for number in range(count):
        start_stream(state, seed, 0, number)
        path_lengths[:] = 0.0
        ray = make_ray(ORIGIN, d, stokes, 0.0, FIRST_ROULETTE_DEPTH, NO_MAX_ORDER)
        ray = enter_layer(state, ray, scene, optics)
        if ray.status == ALIVE:
            ray = trace_history(state, ray, scene, optics, path_lengths, None, None)
        out = ray.direction
        q, u = rotate_reference_to(ray.stokes, out, Vector(-out.z * out.x, 0.0, out.x * out.x))
        side = 0 if ray.status == REFLECTED else 1
        for i, value in enumerate((1.0, q, u, ray.stokes.v)):
            sums[0, side, i] += ray.weight * value
            sums[1, side, i] += (ray.weight * value) ** 2
    return sums


@NEEDS_JIT
@pytest.mark.parametrize("name", PLATES)
def test_plates_have_the_matrices_of_added_interfaces(name):
    """I, Q, U and V of reflected and transmitted light of six polarizations at three angles."""
    count, z = scale_sample_size(200_000), []
    for incidence in ANGLES:
        medium = make_stack(PLATES[name])
        scene, optics = build_scene(medium, incidence, False), compute_optics(medium, NM[0])
        matrices = add_interfaces(PLATES[name], incidence)
        for light in LIGHT.values():
            sums = _trace_light(
                len(z), count, np.array(light), scene, optics, np.zeros(optics.n.size)
            )
            mean, square = sums / count
            stderr = np.sqrt(np.maximum(square - mean**2, 0.0) / count)
            expected = np.array([matrix @ np.array([1.0, *light]) for matrix in matrices])
            assert expected[:, 0].sum() == pytest.approx(1.0, abs=1e-14)
            # Without randomness, such as U of light polarized in the plane, values are exact.
            exact = stderr < 1e-12
            assert np.abs(mean - expected)[exact] == pytest.approx(0.0, abs=1e-12)
            z.append((mean - expected)[~exact] / stderr[~exact])
    family = np.concatenate(z)
    # The elements of one light share their rays.
    judge_z(family, f"plates, {name}", independent=len(LIGHT) * len(ANGLES))


@pytest.mark.parametrize("incidence", [0.0, 30.0, 56.3, 75.0, 89.0])
def test_one_face_reflects_by_fresnel(incidence):
    """Every ray of an opaque layer has the reflectance as its weight."""
    for index in (1.2, 1.5, 2.4):
        medium = make_plate(index, opaque=True)
        ds = splits.goniophotometer(medium, NM, incidence, rays=1000, estimator="bins")
        matrix, _ = compute_interface(1.0, index, math.sin(math.radians(incidence)))
        assert float(ds.specular_reflectance[0]) == pytest.approx(matrix[0, 0], rel=1e-12)


@NEEDS_JIT
@pytest.mark.parametrize("polarized", [True, False])
def test_unpolarized_light_at_a_plate(polarized):
    """2 r/(1 + r) of each component with polarization, of the mean reflectance without it."""
    z = []
    for incidence in (40.0, 70.0, 85.0):
        medium = make_plate(1.5) if polarized else splits.ParticleLayer(
            optical_thickness=0.0, refractive_index=1.5, ground=None
        )  # fmt: skip
        ds = splits.goniophotometer(medium, NM, incidence, rays=1_000_000, estimator="bins")
        matrix, _ = compute_interface(1.0, 1.5, math.sin(math.radians(incidence)))
        plus, minus = matrix[0, 0], matrix[0, 1]
        components = (plus + minus, plus - minus) if polarized else (plus, plus)
        expected = sum(r / (1.0 + r) for r in components)
        for name, value in (
            ("specular_reflectance", expected), ("direct_transmittance", 1.0 - expected)
        ):  # fmt: skip
            z.append(float((ds[name] - value)[0] / ds[f"{name}_stderr"][0]))
    judge_z(z, f"plate, polarized {polarized}", independent=3)


CLEAR = {"refractive_index": {"ice": 1.31, "water": 1.33}}
POINT_GRAINS = "radiative_transfer"
N_POLAR, N_AZIMUTH = 4, 8
BIN_PAIRS = [(0, 1), (0, 2), (1, 2), (0, 3), (1, 3)]
"""Pairs of polar bins, from the zenith; the bins have equal widths of the cosine."""
RAYLEIGH = {
    "optical_thickness": 2.0, "single_scattering_albedo": 1.0, "phase_function": "rayleigh",
    "ground": None, "polarized": True,
}  # fmt: skip


def average_over_incidence(medium, wavelength: float, polar_bin: int, rays: int) -> tuple:
    """Return BRDF and error of light that is isotropic within a polar bin, by bins of view.

    The mean over the cosine of incidence, weighted by it, by three Gaussian nodes.
    """
    x, weight = np.polynomial.legendre.leggauss(3)
    cosine = 1.0 - (polar_bin + 0.5 - 0.5 * x) / N_POLAR
    weight = weight * cosine / (weight * cosine).sum()
    mean, variance = 0.0, 0.0
    for number, (node, share) in enumerate(zip(cosine, weight, strict=True)):
        ds = splits.goniophotometer(
            medium, [wavelength], float(np.degrees(np.arccos(node))), rays=rays,
            estimator="bins", n_bins=(N_POLAR, N_AZIMUTH), stokes=medium.has_grains,
            seed=10 * polar_bin + number,
        ).squeeze("wavelength")  # fmt: skip
        mean = mean + share * ds.brdf.to_numpy()
        variance = variance + (share * ds.brdf_stderr.to_numpy()) ** 2
    return mean, np.sqrt(variance)


@NEEDS_JIT
@pytest.mark.long
@pytest.mark.parametrize(
    ("medium", "wavelength"),
    [
        (splits.Snow(depth_m=0.005, saturation=0.0, interpretation=POINT_GRAINS), 1300.0),
        (splits.Sand(depth_m=0.003, interpretation=POINT_GRAINS), 650.0),
        (splits.ParticleLayer(**{**RAYLEIGH, "optical_thickness": 1.0}), 550.0),
    ],
    ids=["snow", "sand", "particles"],
)
def test_reflection_of_polarized_runs_is_reciprocal(medium, wavelength):
    """Element R11 of the reflection matrix, R(μ, μ0) = P Rᵀ(μ0, μ) P (Hovenier 1969).

    Incidence and view are averaged over the same bins, so that both sides are equal.
    """
    rays = scale_sample_size(300_000)
    runs = [average_over_incidence(medium, wavelength, i, rays) for i in range(N_POLAR)]
    z = []
    for one, other in BIN_PAIRS:
        error = np.hypot(runs[one][1][other], runs[other][1][one])
        z.append((runs[one][0][other] - runs[other][0][one]) / error)
    judge_z(np.array(z), "reciprocity")


@NEEDS_JIT
@pytest.mark.parametrize(
    "medium",
    [
        splits.Snow(depth_m=0.003, saturation=0.0, **CLEAR),
        splits.Snow(depth_m=0.003, saturation=0.5, **CLEAR),
        splits.ParticleLayer(**RAYLEIGH),
        splits.ParticleLayer(**RAYLEIGH, surface=WAVES),
        splits.Stack([splits.ParticleLayer(**RAYLEIGH), splits.Snow(depth_m=0.003, **CLEAR)]),
    ],
    ids=["snow", "wet snow", "particles", "rough", "stack"],
)
def test_energy_is_conserved_without_absorption(medium):
    """Every ray leaves with a weight of 1: the sum is exact but for rounding."""
    ds = splits.goniophotometer(
        medium, [600.0], 50.0, rays=scale_sample_size(100_000), estimator="bins", n_bins=(2, 4),
        stokes=True,
    )  # fmt: skip
    total = float(ds.reflectance[0] + ds.transmittance[0])
    print(f"1 - R - T = {1.0 - total:.1e}")
    assert total == pytest.approx(1.0, abs=1e-12)


@NEEDS_JIT
@pytest.mark.long
@pytest.mark.parametrize(
    ("medium", "wavelength"),
    [
        (splits.Snow(interpretation=POINT_GRAINS), 1300.0), (splits.Snow(), 1300.0),
        (splits.Sand(interpretation=POINT_GRAINS), 650.0), (splits.Sand(), 650.0),
        (splits.ParticleLayer(**RAYLEIGH), 550.0),
    ],
    ids=["snow, radiative_transfer", "snow", "sand, radiative_transfer", "sand", "particles"],
)  # fmt: skip
def test_effect_of_polarization_on_reflectance(medium, wavelength):
    """Reflectances with and without polarization at 60°, to an error below 4e-4."""
    rays = scale_sample_size(3_000_000 if medium.has_grains else 10_000_000)
    scalar_medium = medium
    if not medium.has_grains:
        scalar_medium = splits.ParticleLayer(**{**RAYLEIGH, "polarized": False})
    polarized, scalar = (
        splits.goniophotometer(
            one, [wavelength], 60.0, rays=rays, estimator="bins", n_bins=(2, 4), seed=seed,
            stokes=one.has_grains and seed == 1,
        )
        for seed, one in ((1, medium), (2, scalar_medium))
    )  # fmt: skip
    value = float(scalar.reflectance[0])
    difference = float(polarized.reflectance[0]) - value
    stderr = float(np.hypot(polarized.reflectance_stderr, scalar.reflectance_stderr)[0])
    print(
        f"reflectance {value:.5f}, with polarization {difference:+.5f} ± {stderr:.5f}: "
        f"{100.0 * difference / value:+.3f} ± {100.0 * stderr / value:.3f} %"
    )
    assert stderr < 4e-4
    assert abs(difference) < 0.01 * value + 3.0 * stderr
