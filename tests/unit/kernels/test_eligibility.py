"""Scenes of the vectorized kernel, their features, and the weak extinction that it omits."""

import math
from itertools import pairwise

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from scenes import make_coated_grains, make_medium_scene, make_optics, make_scene
from scipy import integrate

import splits
from splits.kernels.arithmetic import make_tangents, sample_circle
from splits.kernels.grains.spheroid import (
    EntryVariates,
    GrainSize,
    LayerGeometry,
    RejectionRules,
    sample_collision,
)
from splits.kernels.interface import fresnel
from splits.kernels.scene import DRY_PORE, UNIFORM_ENTRY, WET_PORE, Features, Ray, Segment, Vector
from splits.kernels.vectorized.trace import (
    EXTINCTION_TOLERANCE,
    MAX_DEPTH_MFP,
    MIN_FIRST_DEPTH,
    compute_extinction_effect,
    select_features,
)


def find_scene_features(medium, k=0.0, analog=False, depth=None):
    """Return the features of a medium whose grains all have the extinction coefficient k."""
    materials = int(medium.make_grain_population().types.material.max()) + 1
    n = np.full(materials, 1.5)
    n[DRY_PORE], n[WET_PORE] = 1.0, 1.33
    extinction = np.full(materials, k)
    extinction[[DRY_PORE, WET_PORE]] = 0.0
    scene = make_medium_scene(medium, analog=analog, depth=depth or float(medium.depth_m))
    return select_features(scene, make_optics(n, extinction))


def make_features(**present):
    """Return features of which the given ones are present."""
    return Features(*(True if present.pop(name, False) else None for name in Features._fields))


SMOOTH = (0.0, 0.0, 0.0, 0.0)
SCENES = {
    "Table 1": (splits.Snow(), {}, {"wet", "faceted"}),
    "dry": (splits.Snow(saturation=0.0), {}, {"faceted"}),
    "smooth": (splits.Snow(facetness=SMOOTH), {}, {"wet"}),
    "dry and smooth": (splits.Snow(saturation=0.0, facetness=SMOOTH), {}, set()),
    "negligible k": (splits.Snow(), {"k": 1e-8}, {"wet", "faceted"}),
    "significant k": (splits.Snow(), {"k": 0.01}, {"wet", "faceted", "absorbing"}),
    "sand": (splits.Sand(), {}, {"faceted", "mixed"}),
    "wet sand": (splits.Sand(saturation=0.3), {}, {"wet", "faceted", "mixed"}),
    "barely deep enough": (
        splits.Snow(), {"depth": 0.999 * MAX_DEPTH_MFP * splits.Snow().mean_grain_distance_m},
        {"wet", "faceted"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("scene", SCENES)
def test_features_match_the_scene(scene):
    medium, options, expected = SCENES[scene]
    assert find_scene_features(medium, **options) == make_features(**dict.fromkeys(expected, True))


def test_too_grazing_beams_use_the_scalar_kernel():
    grains, optics = splits.Snow().make_grain_population(), make_optics([1.0, 1.33, 1.31])
    min_cos = MIN_FIRST_DEPTH * grains.collision_coefficient / grains.types.inverse_semi_major.min()
    assert min_cos < math.cos(math.radians(89.9999))
    for cos, diffuse, eligible in (
        (0.99 * min_cos, 0.0, False),
        (1.01 * min_cos, 0.0, True),
        (0.99 * min_cos, 0.5, False),
        (0.99 * min_cos, 1.0, True),
    ):
        features = select_features(make_scene(grains, 0.1, cos=cos, diffuse=diffuse), optics)
        assert (features is not None) == eligible


@NEEDS_JIT
def test_grazing_collisions_agree_in_both_precisions():
    # Only entry points next to the top of the grain are sampled: others are never accepted.
    rng, major, flattening, mean_distance = np.random.default_rng(1), 3.75e-4, 0.36, 7e-4
    cos = MIN_FIRST_DEPTH * major / mean_distance
    d = math.sqrt(1.0 - cos * cos), 0.0, -cos
    frame = make_tangents(Vector(-d[0], 0.0, cos))
    upward_azimuth = 0.5 + math.atan2(frame.v.z, frame.u.z) / (2.0 * math.pi)
    width = 10.0 * math.sqrt(cos * mean_distance / major)
    rules = RejectionRules(UNIFORM_ENTRY, True, True, False, False)

    def is_accepted(u, real):
        """Return whether a grain is accepted, with all numbers in one precision."""
        radial, axis_azimuth, axial, distance = width * u[0], u[2], u[3], u[4]
        azimuth = (upward_azimuth + width * (u[1] - 0.5) / math.pi) % 1.0
        variates = EntryVariates(
            real(radial),
            sample_circle(real(azimuth)),
            sample_circle(real(axis_azimuth)),
            real(axial),
            real(0.5),
        )
        origin, downward = Vector(*map(real, (0, 0, 0))), Vector(*map(real, (0, 0, -1)))
        ray = Ray(
            None, origin, origin, Vector(*map(real, d)), Segment(downward, downward, real(-1)),
            real(0), *[None] * 9,
        )  # fmt: skip
        layer = LayerGeometry(*map(real, (mean_distance, -0.1, 0.0, -0.1, 0.0, 0.0)))
        return sample_collision(
            ray, GrainSize(real(major), real(flattening)), variates, real(distance), layer, rules
        ).accepted

    samples = rng.random((40_000, 5))
    double, single = (
        np.array([is_accepted(u, real) for u in samples]) for real in (float, np.float32)
    )
    assert double.sum() > 500
    assert (double != single).sum() < 0.05 * double.sum()
    assert abs(int(double.sum()) - int(single.sum())) < 0.02 * double.sum()


def test_analog_absorption_and_deep_media_use_the_scalar_kernel():
    assert find_scene_features(splits.Snow(), analog=True) is None
    depth = 1.001 * MAX_DEPTH_MFP * splits.Snow().mean_grain_distance_m
    assert find_scene_features(splits.Snow(), depth=depth) is None


@pytest.mark.parametrize("n_coatings", [0, 1, 2, 3])
def test_at_most_one_coating_is_vectorized(n_coatings):
    grains = make_coated_grains([0.01] * n_coatings, [*range(3, 3 + n_coatings), 2])
    features = select_features(make_scene(grains, 0.1), make_optics(np.full(6, 1.5)))
    assert features == (make_features(mixed=n_coatings == 1) if n_coatings < 2 else None)


pytestmark = NEEDS_JIT

QUADRATURE_TOLERANCE = 1.02
"""Largest ratio of adaptive quadrature to the estimate of `compute_extinction_effect`."""

# Extinction coefficients among which the threshold is searched.
EXTINCTIONS = np.logspace(-9.0, -0.5, 171)
GRAINS = {
    "dry": (1.0, 1.31, 0.0),
    "dry, n below 1": (1.0, 0.97, 0.0),
    "wet": (1.33, 1.31, 0.3),
    "wet, heavy grains": (1.33, 1.55, 0.3),
    "in a heavy liquid": (1.6, 1.31, 1.0),
    "nearly matched": (1.33, 1.3301, 1.0),
    "matched": (1.33, 1.33, 1.0),
}


def is_extinction_omitted(n_pore, n_core, k_pore, k_core, saturation):
    """Return whether the extinction of wet pores and of grains is omitted."""
    optics = make_optics([1.0, n_pore, n_core], [0.0, k_pore, k_core])
    features = select_features(
        make_scene(splits.Snow().make_grain_population(), 0.1, saturation), optics
    )
    return features.absorbing is None


@pytest.mark.parametrize("case", GRAINS)
@pytest.mark.parametrize("absorber", ["grains", "pores"])
def test_omitted_extinction_shifts_reflectance_within_tolerance(case, absorber):
    n_pore, n_core, saturation = GRAINS[case]
    extinctions = [(k, 0.0) if absorber == "pores" else (0.0, k) for k in EXTINCTIONS]
    omitted = np.array([is_extinction_omitted(n_pore, n_core, *k, saturation) for k in extinctions])
    assert omitted[0] and (np.diff(omitted.astype(int)) <= 0).all()
    if absorber == "pores":
        if saturation == 0.0:
            assert omitted.all()
            return
        pairs = [(n_core, n_pore)]
    else:
        pairs = [(1.0, n_core)] + ([(n_pore, n_core)] if saturation > 0.0 else [])
    largest = EXTINCTIONS[np.flatnonzero(omitted)[-1]]
    shift = max(compute_reflectance_shift(*pair, largest) for pair in pairs)
    print(f"omitted up to k = {largest:.1e}, which shifts R by {shift:.1e}")
    assert shift < QUADRATURE_TOLERANCE * EXTINCTION_TOLERANCE
    # The threshold is not needlessly low: one step higher the shift would be significant.
    assert (
        max(
            compute_reflectance_shift(*pair, largest * EXTINCTIONS[1] / EXTINCTIONS[0])
            for pair in pairs
        )
        > EXTINCTION_TOLERANCE / 4.0
    )


def test_vectorized_kernel_is_rejected_for_ineligible_media():
    match = r"kernel = 'vectorized'.*'auto' or 'scalar'"
    with pytest.raises(ValueError, match=match):
        splits.spectrophotometer(
            splits.Snow(), 500.0, max_stderr=0.5, kernel="vectorized", estimator="analog"
        )
    deep = splits.Snow(depth_m=1.001 * MAX_DEPTH_MFP * splits.Snow().mean_grain_distance_m)
    with pytest.raises(ValueError, match=match):
        splits.beam_spread(deep, 500.0, rays=10, kernel="vectorized")


# --- weak extinction --------------------------------------------------------------------------


def compute_diffuse_reflectance(n1, n2, k):
    """Return the reflectance of diffuse light, ∫ 2μ R dμ, split at the critical angle."""
    critical = np.sqrt(max(1.0 - (n2 / n1) ** 2, 0.0))
    breakpoints = sorted({1e-9, 1.0, *(x for x in (critical,) if 0.0 < x < 1.0)})
    # R has a square-root singularity at the critical angle, which the substitution smooths.
    total = 0.0
    for low, high in pairwise(breakpoints):
        width = high - low

        def integrand(t, low=low, width=width):
            mu = low + width * t * t * (3.0 - 2.0 * t)
            return 2.0 * mu * fresnel(n1, n2, k, mu)[0] * width * 6.0 * t * (1.0 - t)

        total += integrate.quad(integrand, 0.0, 1.0, epsabs=1e-9, limit=400)[0]
    return total


def compute_reflectance_shift(n1, n2, k):
    """Return the shift of the diffuse reflectance by extinction on the transmitted side."""
    return abs(compute_diffuse_reflectance(n1, n2, k) - compute_diffuse_reflectance(n1, n2, 0.0))


INDICES = np.unique(np.concatenate([np.linspace(0.95, 1.6, 14), [0.99, 0.999, 1.0, 1.001, 1.01]]))


@pytest.mark.parametrize("inwards", [True, False])
@pytest.mark.parametrize("k", [1e-6, 3e-6, 1e-4, 1e-3, 3e-3])
def test_extinction_effect_bounds_the_reflectance_shift(k, inwards):
    """The estimate is an upper bound up to quadrature errors, and not far above the shift."""
    ratios = []
    for m in INDICES:
        n1, n2 = (1.0, m) if inwards else (m, 1.0)
        optics = make_optics([n1, n2], [0.0, k])
        estimate, exact = (
            compute_extinction_effect(optics, 0, 1),
            compute_reflectance_shift(n1, n2, k),
        )
        ratios.append(estimate / max(exact, 1e-8))
        assert estimate > exact / QUADRATURE_TOLERANCE - 1e-8, (n1, n2)
        # For nearly equal indices R may rise at some angles and fall at others.
        assert estimate < 4.0 * exact + 1e-8 or abs(m - 1.0) < 0.06, (n1, n2)
    print(f"k {k}: ratio of estimate to shift {min(ratios):.2f} to {max(ratios):.2f}")


def test_zero_extinction_has_no_effect():
    optics = make_optics([1.31, 1.0])
    assert compute_extinction_effect(optics, 0, 1) == 0.0
