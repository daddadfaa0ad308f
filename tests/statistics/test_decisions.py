"""Coins that kernels toss: free paths, reflect or refract, air or water, diffuse light."""

from __future__ import annotations

import math

import numpy as np
import pytest
from chi2 import draw, judge_p, judge_z, p_of_values, scaled, tabulated_cdf
from numba import njit
from spheroids import dot, gradient, nearest, real_point

import splits
from splits.media import grain_statistics
from splits.transport import facets, fresnel, grain, granular
from splits.transport.scene import DRY_PORE, WET_PORE, Slab

COUNT = scaled(200_000)
NO_LEG = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0)
# Semi-major axes of SPLITSnow Table 1 (m).
LOW, HIGH = 1.5e-4, 3.75e-4
DEEP = Slab(1e4, 0.0, 1.0, False)


def binomial_z(hits, p):
    """Return how many standard errors a share of hits lies from p, in a list.

    What is certain, p = 0 or 1, must be so, and is no comparison.
    """
    share = np.mean(hits)
    if p in (0.0, 1.0):
        assert share == p
        return []
    return [(share - p) / math.sqrt(p * (1.0 - p) / np.size(hits))]


@njit
def _next_grain(state, z, dx, dy, dz, to_boundary, grains, slab, rules, last_leg):
    """Return leg, semi-minor axis, flattening, entry point, major axis and normal."""
    leg, _, minor, flattening, q1, q2, q3, w1, w2, w3, n1, n2, n3 = granular.next_grain(
        state, z, dx, dy, dz, to_boundary, last_leg, grains, slab, rules
    )
    return leg, minor, flattening, q1, q2, q3, w1, w2, w3, n1, n2, n3


def next_grains(count, z, d, snow, slab=DEEP, last_leg=NO_LEG, ahead=5e3):
    """Draw next grains, the boundary ahead at a distance (m); vectors as (count, 3)."""
    out = draw(
        _next_grain, count, z, *d, ahead, snow.grains(), slab, snow.readings.rules(), last_leg,
        width=12,
    )  # fmt: skip
    return *out[:, :3].T, out[:, 3:6], out[:, 6:9], out[:, 9:]


def test_free_path_and_grain_in_a_deep_medium():
    p = {}
    for entry in ("uniform", "projected"):
        snow = splits.Snow(depth_m=1e4, saturation=0.0, readings={"entry": entry})
        d = (0.48, -0.64, 0.6)
        leg, minor, flattening, q, w, n = next_grains(scaled(100_000), -5e3, d, snow)
        # A grain that the ray strikes from outside, with the normal of the point it strikes.
        assert np.abs((q * q).sum(axis=1) - 1.0).max() < 1e-12
        assert np.abs((w * w).sum(axis=1) - 1.0).max() < 1e-12
        at = real_point(q, w, minor, flattening)
        assert np.abs(gradient(at, w, minor, flattening) - n).max() < 1e-11
        assert dot(n, d).max() < 0.0
        b, psi = minor / (1.0 - flattening), np.sqrt(1.0 - flattening)
        distance = snow.mean_grain_distance_m
        p[entry, "distance"] = p_of_values(leg, lambda x, d=distance: -np.expm1(-x / d))
        p[entry, "size"] = p_of_values(b, lambda s: (1 / LOW - 1 / s) / (1 / LOW - 1 / HIGH))
        limits = snow.sphericity

        def density(x, limits=limits):
            bell = np.exp(-0.5 * ((x - limits[2]) / limits[3]) ** 2)
            return grain_statistics.surface_to_volume(x) * bell

        p[entry, "sphericity"] = p_of_values(psi, tabulated_cdf(density, *limits[:2]))
    judge_p(p)


def test_grain_is_forgotten_when_the_boundary_comes_first():
    snow = splits.Snow(depth_m=1e4)
    legs = draw(
        _next_leg, scaled(50_000), snow.mean_grain_distance_m, snow.grains(), DEEP,
        snow.readings.rules(), NO_LEG,
    )  # fmt: skip
    # The boundary lies one mean distance ahead: e^-1 of all rays get there.
    reached = legs == snow.mean_grain_distance_m
    assert legs.max() == snow.mean_grain_distance_m
    judge_z(binomial_z(reached, math.exp(-1.0)), "boundary first")


@njit
def _next_leg(state, to_boundary, grains, slab, rules, no_leg):
    return granular.next_grain(
        state, -5e3, 0.0, 0.0, 1.0, to_boundary, no_leg, grains, slab, rules
    )[0]


@njit
def _crossed(state, mu, n1, n2):
    passed, dx, dy, dz = granular.cross_boundary(
        state, math.sqrt(1.0 - mu * mu), 0.0, mu, n1, n2, 0.0
    )
    return 1.0 if passed else 0.0, dx, dy, dz


def test_share_reflected_at_an_extended_boundary():
    z = []
    for n1, n2 in ((1.0, 1.33), (1.33, 1.0), (1.0, 1.0), (1.0, 3.0)):
        for mu in (1.0, 0.7, 0.3, 0.05, -0.9, -0.2):
            out = draw(_crossed, COUNT // 4, mu, n1, n2, width=4)
            passed, dx, dy, dz = out.T
            sine_t = n1 / n2 * math.sqrt(1.0 - mu * mu)
            reflectance, _, _ = fresnel.interface(n1, n2, 0.0, abs(mu))
            z += binomial_z(passed, 1.0 - reflectance)
            went = passed == 1.0
            assert (dz[~went] == -mu).all() and (dy == 0.0).all()
            assert (np.sign(dz[went]) == np.sign(mu)).all()
            assert not went.any() or np.abs(dx[went] - sine_t).max() < 1e-12
    judge_z(z, "boundary")


@njit
def _interacted(state, cos_i, n1, n2, k2, rules):
    sin_i = math.sqrt(1.0 - cos_i * cos_i)
    passed, dx, dy, dz = grain.interact(
        state, sin_i, 0.0, -cos_i, 0.0, 0.0, 1.0, 0.0, n1, 0.0, n2, k2, rules
    )
    return 1.0 if passed else 0.0, dx, dy, dz


def test_share_reflected_at_a_smooth_grain():
    rules = splits.Readings().rules()
    z = []
    for n1, n2, k2 in ((1.0, 1.31, 0.0), (1.31, 1.0, 0.0), (1.31, 1.33, 1e-3), (1.0, 1.3, 0.5)):
        for cos_i in (1.0, 0.8, 0.5, 0.1):
            passed, _, _, dz = draw(_interacted, COUNT // 4, cos_i, n1, n2, k2, rules, width=4).T
            z += binomial_z(passed, 1.0 - fresnel.interface(n1, n2, k2, cos_i)[0])
            assert ((dz < 0.0) == (passed == 1.0)).all()
    judge_z(z, "grain")


@njit
def _rough(state, cos_i, n1, n2, rules):
    """Return the reflectance expected at the facet drawn, and whether the ray was reflected."""
    sin_i = math.sqrt(1.0 - cos_i * cos_i)
    _, _, _, cosine = facets.struck_facet(
        state, sin_i, 0.0, -cos_i, 0.0, 0.0, 1.0, 0.8, rules.facets
    )
    expected = fresnel.interface(n1, n2, 0.0, cosine)[0]
    passed, _, _, dz = grain.interact(
        state, sin_i, 0.0, -cos_i, 0.0, 0.0, 1.0, 0.8, n1, 0.0, n2, 0.0, rules
    )
    return expected, 0.0 if passed else 1.0, 1.0 if (dz < 0.0) == passed else 0.0


def test_share_reflected_at_a_rough_grain():
    # Reflectance averaged over facets against the share of rays reflected; whatever facet is
    # met, a ray ends up on the side of the macroscopic surface that it was sent to.
    z = []
    for wrong_side in ("lobe", "mirrored"):
        for rule in ("projected", "unweighted", "any"):
            rules = splits.Readings(facets=rule, wrong_side=wrong_side).rules()
            for n1, n2 in ((1.0, 1.31), (1.31, 1.0)):
                for cos_i in (0.9, 0.3):
                    out = draw(_rough, COUNT // 8, cos_i, n1, n2, rules, width=3)
                    expected, reflected, right_side = out.T
                    assert right_side.all()
                    error = math.sqrt((expected.var() + reflected.var()) / len(out))
                    z.append((expected.mean() - reflected.mean()) / error)
    judge_z(z, "rough grain")


@njit
def _pore(state, saturation):
    return float(grain.draw_pore(state, saturation))


def test_pore_medium_follows_saturation():
    z = []
    for saturation in (0.0, 0.05, 0.3, 1.0):
        pore = draw(_pore, COUNT, saturation)
        assert set(np.unique(pore)) <= {float(DRY_PORE), float(WET_PORE)}
        z += binomial_z(pore == WET_PORE, saturation)
    judge_z(z, "pore")


LAST_LEGS = {
    # Straight on from where the last leg ended, and some way through a grain from there.
    "reversal": (0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 2e-3),
    "beyond a grain": (1e-4, -5e-5, 2e-4, -0.28, 0.0, -0.96, 3e-3),
}


@pytest.mark.parametrize("name", LAST_LEGS)
def test_no_grain_lies_on_the_last_leg_unless_kept(name):
    last_leg = LAST_LEGS[name]
    g, back, length = np.array(last_leg[:3]), np.array(last_leg[3:6]), last_leg[6]
    d = np.array([0.1, 0.0, math.sqrt(0.99)])
    least = {}
    for fate in ("reject", "keep", "skip"):
        snow = splits.Snow(depth_m=1e4, readings={"grain_on_last_leg": fate})
        leg, minor, flattening, q, w, _ = next_grains(
            scaled(20_000), -5e3, d, snow, last_leg=last_leg
        )
        # Both ends of the last leg as seen from the grain's centre.
        end = real_point(q, w, minor, flattening) - leg[:, None] * d - g
        least[fate] = nearest(end - length * back, end, w, minor, flattening)
    assert min(least["reject"].min(), least["skip"].min()) >= 1.0
    assert (least["keep"] < 1.0).mean() > {"reversal": 0.5, "beyond a grain": 0.3}[name]


@pytest.mark.parametrize("z", [-1e-4, -9e-4])
def test_no_grain_crosses_a_boundary_unless_kept(z):
    slab = Slab(1e-3, 0.0, 1.0, False)
    d = np.array([0.8, 0.0, 0.6])
    share = {}
    for fate in ("reject", "keep", "skip"):
        snow = splits.Snow(depth_m=1e-3, readings={"grain_across_boundary": fate})
        # Refused grains are drawn again for ever, unless the ray may reach the boundary.
        ahead = -z / d[2] if fate == "skip" else 5e3
        drawn = next_grains(scaled(20_000), z, d, snow, slab, ahead=ahead)
        leg, minor, flattening, q, w, _ = (values[drawn[0] < ahead] for values in drawn)
        centre = z + leg * d[2] - real_point(q, w, minor, flattening)[:, 2]
        # Where the gradient is vertical: c² + (b² − c²) w_z² is the square of the half height.
        major = minor / (1.0 - flattening)
        half = np.sqrt(minor**2 + (major**2 - minor**2) * w[:, 2] ** 2)
        share[fate] = ((centre + half > 1e-15) | (centre - half < -1e-3 - 1e-15)).mean()
    assert share["reject"] == share["skip"] == 0.0
    assert share["keep"] > 0.2


def test_skipped_grains_thin_the_process_of_grains():
    """Spheres of radius a whose poles lie a (1 − n_z) above their points of entry.

    With n_z uniform, or its square for projected entry, they fit at depth s < a with probability
    s/a, or 1 − (1 − s/a)²; the integral of that is the optical thickness of the way down.
    """
    a, depth = 2e-4, 1e4
    p = {}
    for entry in ("uniform", "projected"):
        snow = splits.Snow(
            depth_m=depth, grain_size_um=(400, 400), sphericity=(1.0, 1.0, 1.0, 0.0),
            density_kg_m3=450, readings={"grain_across_boundary": "skip", "entry": entry},
        )  # fmt: skip
        leg = next_grains(COUNT, 0.0, np.array([0.0, 0.0, -1.0]), snow)[0]

        def law(s, entry=entry, per_metre=1.0 / snow.mean_grain_distance_m):
            x = np.minimum(s / a, 1.0)
            within = x**2 / 2.0 if entry == "uniform" else x**2 - x**3 / 3.0
            beyond = np.maximum(s - a, 0.0)
            return -np.expm1(-per_metre * (a * within + beyond))

        p[entry] = p_of_values(leg, law)
    judge_p(p)
