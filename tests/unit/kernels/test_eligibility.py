"""Which scenes lanes serve, with which features; and what faint extinction they leave out."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from chi2 import NEEDS_JIT
from scenes import make_coated_grains, make_medium_scene, make_optics, make_scene
from scipy import integrate

import splits
from splits.kernels.compiler.features import Features
from splits.kernels.grains.free_path import (
    LayerGeometry,
    RayGeometry,
    RejectionRules,
    sample_collision,
)
from splits.kernels.grains.scene import DRY_PORE, WET_PORE
from splits.kernels.grains.spheroid import UNIFORM_ENTRY, EntryVariates, GrainSize, Segment
from splits.kernels.math.elementary import sample_circle
from splits.kernels.math.vectors import Vector, make_tangents
from splits.kernels.optics.fresnel import fresnel
from splits.kernels.vectorized.eligibility import (
    EXTINCTION_TOLERANCE,
    MAX_DEPTH_MFP,
    MIN_FIRST_DEPTH,
    compute_extinction_effect,
    select_features,
)


def find_features(medium, k=0.0, analog=False, depth=None):
    """Return what lanes have for a medium whose grains all have the extinction coefficient k."""
    materials = int(medium.make_grain_population().types.material.max()) + 1
    n = np.full(materials, 1.5)
    n[DRY_PORE], n[WET_PORE] = 1.0, 1.33
    extinction = np.full(materials, k)
    extinction[[DRY_PORE, WET_PORE]] = 0.0
    scene = make_medium_scene(medium, analog=analog, depth=depth or float(medium.depth_m))
    return select_features(scene, make_optics(n, extinction))


def make_features(**present):
    """Return features of which those named are present."""
    return Features(*(True if present.pop(name, False) else None for name in Features._fields))


SMOOTH = (0.0, 0.0, 0.0, 0.0)
SCENES = {
    "Table 1": (splits.Snow(), {}, {"wet", "faceted"}),
    "dry": (splits.Snow(saturation=0.0), {}, {"faceted"}),
    "smooth": (splits.Snow(facetness=SMOOTH), {}, {"wet"}),
    "dry and smooth": (splits.Snow(saturation=0.0, facetness=SMOOTH), {}, set()),
    "k that does not show": (splits.Snow(), {"k": 1e-8}, {"wet", "faceted"}),
    "k that shows": (splits.Snow(), {"k": 0.01}, {"wet", "faceted", "absorbing"}),
    "sand": (splits.Sand(), {}, {"faceted", "mixed"}),
    "wet sand": (splits.Sand(saturation=0.3), {}, {"wet", "faceted", "mixed"}),
    "barely deep enough": (
        splits.Snow(), {"depth": 0.999 * MAX_DEPTH_MFP * splits.Snow().mean_grain_distance_m},
        {"wet", "faceted"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("scene", SCENES)
def test_features_are_those_of_the_scene(scene):
    medium, how, expected = SCENES[scene]
    assert find_features(medium, **how) == make_features(**dict.fromkeys(expected, True))


def test_grazing_beams_are_left_to_the_scalar_kernel_where_grains_are_met_too_high():
    grains, optics = splits.Snow().make_grain_population(), make_optics([1.0, 1.33, 1.31])
    lowest = MIN_FIRST_DEPTH * grains.attenuation / grains.types.curvature.min()
    assert lowest < math.cos(math.radians(89.9999))
    for cos, diffuse, served in (
        (0.99 * lowest, 0.0, False),
        (1.01 * lowest, 0.0, True),
        (0.99 * lowest, 0.5, False),
        (0.99 * lowest, 1.0, True),
    ):
        found = select_features(make_scene(grains, 0.1, cos=cos, diffuse=diffuse), optics)
        assert (found is not None) == served


@NEEDS_JIT
def test_precisions_decide_alike_whether_the_first_grain_of_a_grazing_beam_fits():
    # Only entry points next to the grain's top are tried: others never fit.
    rng, major, flattening, mean_leg = np.random.default_rng(1), 3.75e-4, 0.36, 7e-4
    cos = MIN_FIRST_DEPTH * major / mean_leg
    d = math.sqrt(1.0 - cos * cos), 0.0, -cos
    frame = make_tangents(Vector(-d[0], 0.0, cos))
    up = 0.5 + math.atan2(frame.v.z, frame.u.z) / (2.0 * math.pi)
    width = 10.0 * math.sqrt(cos * mean_leg / major)
    fates = RejectionRules(UNIFORM_ENTRY, True, True, False, False)

    def fits(u, real):
        """Tell whether a grain fits, with all numbers in one precision."""
        facing, turn, axial, leg = width * u[0], u[2], u[3], u[4]
        azimuth = (up + width * (u[1] - 0.5) / math.pi) % 1.0
        aim = EntryVariates(
            real(facing),
            sample_circle(real(azimuth)),
            sample_circle(real(turn)),
            real(axial),
            real(0.5),
        )
        origin, down = Vector(*map(real, (0, 0, 0))), Vector(*map(real, (0, 0, -1)))
        ray = RayGeometry(
            origin, origin, Vector(*map(real, d)), Segment(down, down, real(-1)), real(0)
        )
        space = LayerGeometry(*map(real, (mean_leg, -0.1, 0.0, -0.1, 0.0, 0.0)))
        return sample_collision(
            ray, GrainSize(real(major), real(flattening)), aim, real(leg), space, fates
        ).accepted

    draws = rng.random((40_000, 5))
    double, single = (np.array([fits(u, real) for u in draws]) for real in (float, np.float32))
    assert double.sum() > 500
    assert (double != single).sum() < 0.05 * double.sum()
    assert abs(int(double.sum()) - int(single.sum())) < 0.02 * double.sum()


def test_coin_tosses_and_depths_are_left_to_the_scalar_kernel():
    assert find_features(splits.Snow(), analog=True) is None
    deep = 1.001 * MAX_DEPTH_MFP * splits.Snow().mean_grain_distance_m
    assert find_features(splits.Snow(), depth=deep) is None


@pytest.mark.parametrize("coats", [0, 1, 2, 3])
def test_at_most_one_coating(coats):
    grains = make_coated_grains([0.01] * coats, [*range(3, 3 + coats), 2])
    found = select_features(make_scene(grains, 0.1), make_optics(np.full(6, 1.5)))
    assert found == (make_features(mixed=coats == 1) if coats < 2 else None)


pytestmark = NEEDS_JIT

QUADRATURE = 1.02
"""How far the estimate of `compute_extinction_effect` may fall short of adaptive quadrature."""

# Where to look for the extinction at which it starts to show.
EDGES = np.logspace(-9.0, -0.5, 171)
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
    """Return whether extinction coefficients of wet pores and of grains are left out."""
    optics = make_optics([1.0, n_pore, n_core], [0.0, k_pore, k_core])
    found = select_features(
        make_scene(splits.Snow().make_grain_population(), 0.1, saturation), optics
    )
    return found.absorbing is None


@pytest.mark.parametrize("where", GRAINS)
@pytest.mark.parametrize("whose", ["grains", "pores"])
def test_extinction_that_is_left_out_moves_no_interface_by_more_than_promised(where, whose):
    n_pore, n_core, saturation = GRAINS[where]
    at = [(k, 0.0) if whose == "pores" else (0.0, k) for k in EDGES]
    out = np.array([is_extinction_omitted(n_pore, n_core, *k, saturation) for k in at])
    assert out[0] and (np.diff(out.astype(int)) <= 0).all()
    if whose == "pores":
        if saturation == 0.0:
            assert out.all()
            return
        pairs = [(n_core, n_pore)]
    else:
        pairs = [(1.0, n_core)] + ([(n_pore, n_core)] if saturation > 0.0 else [])
    last = EDGES[np.flatnonzero(out)[-1]]
    moved = max(compute_reflectance_shift(*pair, last) for pair in pairs)
    print(f"left out up to k = {last:.1e}, which moves R by {moved:.1e}")
    assert moved < QUADRATURE * EXTINCTION_TOLERANCE
    # Nor is more asked for than needed: a step of the grid further it would show.
    assert (
        max(compute_reflectance_shift(*pair, last * EDGES[1] / EDGES[0]) for pair in pairs)
        > EXTINCTION_TOLERANCE / 4.0
    )


def test_the_public_interface_refuses_lanes_that_cannot_serve():
    match = r"kernel = 'vectorized'.*'auto' or 'scalar'"
    with pytest.raises(ValueError, match=match):
        splits.spectrophotometer(
            splits.Snow(), 500.0, max_stderr=0.5, kernel="vectorized", estimator="analog"
        )
    deep = splits.Snow(depth_m=1.001 * MAX_DEPTH_MFP * splits.Snow().mean_grain_distance_m)
    with pytest.raises(ValueError, match=match):
        splits.beam_spread(deep, 500.0, rays=10, kernel="vectorized")


# --- faint extinction -------------------------------------------------------------------------


def compute_diffuse_reflectance(n1, n2, k):
    """Return the reflectance of diffuse light, ∫ 2μ R dμ, with the critical angle as a seam."""
    critical = np.sqrt(max(1.0 - (n2 / n1) ** 2, 0.0))
    seams = sorted({1e-9, 1.0, *(x for x in (critical,) if 0.0 < x < 1.0)})
    # Total reflection ends with a root, which the substitution below smooths on both sides.
    total = 0.0
    for low, high in pairwise(seams):
        width = high - low

        def integrand(t, low=low, width=width):
            mu = low + width * t * t * (3.0 - 2.0 * t)
            return 2.0 * mu * fresnel(n1, n2, k, mu)[0] * width * 6.0 * t * (1.0 - t)

        total += integrate.quad(integrand, 0.0, 1.0, epsabs=1e-9, limit=400)[0]
    return total


def compute_reflectance_shift(n1, n2, k):
    """Return how much the far side's extinction moves the reflectance of diffuse light."""
    return abs(compute_diffuse_reflectance(n1, n2, k) - compute_diffuse_reflectance(n1, n2, 0.0))


INDICES = np.unique(np.concatenate([np.linspace(0.95, 1.6, 14), [0.99, 0.999, 1.0, 1.001, 1.01]]))


@pytest.mark.parametrize("inwards", [True, False])
@pytest.mark.parametrize("k", [1e-6, 3e-6, 1e-4, 1e-3, 3e-3])
def test_what_extinction_does_to_diffuse_light(k, inwards):
    """The estimate is not below the true shift, but for quadrature, nor far above it."""
    ratios = []
    for m in INDICES:
        n1, n2 = (1.0, m) if inwards else (m, 1.0)
        optics = make_optics([n1, n2], [0.0, k])
        estimate, exact = (
            compute_extinction_effect(optics, 0, 1),
            compute_reflectance_shift(n1, n2, k),
        )
        ratios.append(estimate / max(exact, 1e-8))
        assert estimate > exact / QUADRATURE - 1e-8, (n1, n2)
        # R may rise at some angles and fall at others, where indices are about equal.
        assert estimate < 4.0 * exact + 1e-8 or abs(m - 1.0) < 0.06, (n1, n2)
    print(f"k {k}: estimate over shift {min(ratios):.2f} to {max(ratios):.2f}")


def test_nothing_shows_without_extinction():
    optics = make_optics([1.31, 1.0])
    assert compute_extinction_effect(optics, 0, 1) == 0.0
