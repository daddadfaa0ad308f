"""Scattering matrices of grains, all 16 elements: mirror symmetry, reciprocity, bounds, ends.

`single_scattering` assumes the symmetries of randomly oriented grains that are their own mirror
images, and estimates six elements.  Here all elements come from rays of unpolarized, linearly and
circularly polarized light.  With the azimuth φ of the scattering plane from the direction of linear
polarization, incident light has Q = cos2φ and U = −sin2φ in that plane.
"""

from functools import cache

import numpy as np
import pytest
from chi2 import NEEDS_JIT, judge_z
from numba import njit
from scenes import compute_optics

import splits
from splits.kernels.arithmetic import linear_combination
from splits.kernels.grains.grain_path import trace_through_grain
from splits.kernels.grains.single_grain import sample_hit_grain
from splits.kernels.grains.spheroid import FIRST_ROULETTE_DEPTH
from splits.kernels.rays import make_ray
from splits.kernels.records import IsolatedGrain
from splits.kernels.rng import start_stream
from splits.kernels.scene import ALIVE, NO_MAX_ORDER, ORIGIN, UP, Stokes, Vector
from splits.kernels.stokes import compute_azimuth, rotate_reference_to
from splits.kernels.tallies.exits import compute_path_weight
from splits.simulation.scene import IncidentPolarization, build_scene

pytestmark = NEEDS_JIT

N_BATCHES, N_BINS = 256, 18
FORWARD, BACKWARD = N_BINS, N_BINS + 1
"""Additional bins next to the forward and the backward direction."""
FORWARD_DEG, BACKWARD_DEG = 0.4, 178.0
UNPOLARIZED, LINEAR, CIRCULAR = range(3)
FACETS = {
    "entry_point": "projected", "facet_sampling": "projected", "wrong_side_ray": "cosine_lobe",
}  # fmt: skip
MIRRORED = {**FACETS, "wrong_side_ray": "mirror"}
MEDIA = {
    "snow": (splits.Snow(saturation=0.0, interpretation=FACETS), 600.0),
    "smooth snow": (
        splits.Snow(facetness=(0.0,) * 4, saturation=0.0, interpretation=FACETS), 1300.0
    ),
    "sand": (splits.Sand(interpretation=FACETS), 650.0),
    "smooth coated sand": (
        splits.Sand(roundness=(1.0, 0.0), partition=(0.0, 0.0, 1.0), interpretation=FACETS), 450.0
    ),
}  # fmt: skip
MIRRORED_MEDIA = {"mirrored sand": (splits.Sand(interpretation=MIRRORED), 650.0)}
X, Y = Vector(1.0, 0.0, 0.0), Vector(0.0, 1.0, 0.0)


@njit
def _tally(first, count, grain, absorption, sums):
    """Add the Stokes vectors of rays of each kind to `sums`, of columns of the matrix.

    The last axis of `sums` has the weights 1, cos2φ and −sin2φ.
    """
    path_lengths, state = np.zeros(absorption.shape[1]), np.zeros(1, dtype=np.uint64)
    for number in range(first, first + count):
        kind = number % 3
        start_stream(state, 7, 0, number)
        path_lengths[:] = 0.0
        light = Stokes(X, 1.0 if kind == 1 else 0.0, 0.0, 1.0 if kind == 2 else 0.0)
        ray = make_ray(ORIGIN, UP, light, 1.0, FIRST_ROULETTE_DEPTH, NO_MAX_ORDER)
        sample, entry = sample_hit_grain(state, grain)
        ray = trace_through_grain(
            state, ray, sample, entry, grain.scene, grain.optics, path_lengths
        )
        if ray.status != ALIVE:
            continue
        d = ray.direction
        azimuth = compute_azimuth(d, X, Y)
        cos2 = azimuth.cos * azimuth.cos - azimuth.sin * azimuth.sin
        sin2 = 2.0 * azimuth.cos * azimuth.sin
        plane = Vector(azimuth.cos, azimuth.sin, 0.0)
        reference = linear_combination(d.z, plane, -azimuth.sin_polar, UP)
        q, u = rotate_reference_to(ray.stokes, d, reference)
        angle = np.degrees(np.arctan2(azimuth.sin_polar, d.z))
        weight = compute_path_weight(path_lengths, ray.weight, absorption, 0)
        batch = sums[(number // 3) % sums.shape[0], kind]
        for row, value in enumerate((1.0, q, u, ray.stokes.v)):
            for column, factor in enumerate((1.0, cos2, -sin2)):
                score = weight * value * factor
                batch[min(int(angle / 10.0), N_BINS - 1), row, column] += score
                if angle < FORWARD_DEG:
                    batch[FORWARD, row, column] += score
                elif angle > BACKWARD_DEG:
                    batch[BACKWARD, row, column] += score


@cache
def estimate_batches(name: str) -> np.ndarray:
    """Return elements, shape (batches, rows, columns, bins), from half a million rays a kind.

    Those of bins are integrals; the sum of P11 over the bins of 10° is 1.
    """
    medium, wavelength = {**MEDIA, **MIRRORED_MEDIA}[name]
    scene, optics = (
        build_scene(medium, 0.0, False, IncidentPolarization()),
        compute_optics(medium, wavelength),
    )
    sums = np.zeros((N_BATCHES, 3, N_BINS + 2, 4, 3))
    grain = IsolatedGrain(0.0, scene, optics)
    # Few rays of smooth grains are scattered backward, and batches of few are not normal.
    n_rays = 6_000_000 if name.startswith("smooth") else 1_500_000
    _tally(0, n_rays, grain, optics.absorption[np.newaxis], sums)
    columns = [
        sums[:, UNPOLARIZED, ..., 0], 2.0 * sums[:, LINEAR, ..., 1], 2.0 * sums[:, LINEAR, ..., 2],
        sums[:, CIRCULAR, ..., 0] - sums[:, UNPOLARIZED, ..., 0],
    ]  # fmt: skip
    batches = np.stack(columns, axis=-1).transpose(0, 2, 3, 1)
    return batches / batches[:, 0, 0, :N_BINS].mean(axis=0).sum()


def estimate_mean(batches: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean over batches and its standard error."""
    return batches.mean(axis=0), batches.std(axis=0, ddof=1) / len(batches) ** 0.5


def combine(name: str, terms: str, bins: slice | int = slice(N_BINS)) -> tuple:
    """Return a sum of elements, such as "+21 -12" by row and column, and its standard error."""
    batches = estimate_batches(name)
    return estimate_mean(
        sum(
            float(f"{term[0]}1") * batches[:, int(term[1]) - 1, int(term[2]) - 1, bins]
            for term in terms.split()
        )
    )


def compute_z(name: str, terms: str, bins: slice | int = slice(N_BINS)) -> np.ndarray:
    """Return a sum of elements that should vanish, in standard errors."""
    value, stderr = combine(name, terms, bins)
    return np.atleast_1d(value / stderr)


@pytest.mark.parametrize("name", MEDIA)
def test_mirror_images_of_grains_scatter_alike(name):
    zero = ("+13", "+14", "+23", "+24", "+31", "+32", "+41", "+42")
    judge_z(np.array([compute_z(name, element) for element in zero]), f"mirror symmetry, {name}")


@pytest.mark.parametrize("name", MEDIA)
def test_matrices_are_reciprocal(name):
    z = [compute_z(name, terms) for terms in ("+21 -12", "+43 +34")]
    judge_z(np.array(z), f"reciprocity, {name}")


def test_mirrored_directions_are_not_reciprocal():
    """Facets that reflect light to the wrong side: the reverse of a mirrored path does not exist.

    docs/theory/polarization.md has the largest difference.
    """
    p11, _ = combine("mirrored sand", "+11")
    for terms in ("+21 -12", "+43 +34"):
        difference, error = combine("mirrored sand", terms)
        largest = np.abs(difference / p11).argmax()
        print(f"{terms}: {difference[largest] / p11[largest]:+.3f} of P11")
        assert np.abs(difference / error).max() > 4.0
        assert np.abs(difference / p11).max() < 0.06


@pytest.mark.parametrize("name", MEDIA)
def test_directions_of_symmetry(name):
    """Forward, P22 = P33; backward, P22 = −P33; P12 = P34 = 0 in both.

    Backward, P44 = P11 − 2 P22 holds for waves (Mishchenko & Hovenier 1995), because a path and its
    reverse interfere.  Without interference it is an upper bound of P44.
    """
    z = [compute_z(name, "+22 -33", FORWARD), compute_z(name, "+22 +33", BACKWARD)]
    for end in (FORWARD, BACKWARD):
        z += [compute_z(name, element, end) for element in ("+12", "+21", "+34", "+43")]
    judge_z(np.array(z), f"ends, {name}")
    p11, _ = combine(name, "+11", BACKWARD)
    excess, error = combine(name, "+44 -11 +22 +22", BACKWARD)
    print(f"{name}: P44 is {excess / p11:+.3f} ± {error / p11:.3f} of P11 above P11 − 2 P22")
    assert excess < 3.0 * error
    lack, error = combine(name, "+44 +11 -22 -22", FORWARD)
    assert lack > -3.0 * error


@pytest.mark.parametrize("name", MEDIA)
def test_elements_have_the_bounds_of_sums_of_pure_matrices(name):
    """Hovenier & van der Mee (1983), for matrices with the symmetries above, within errors."""
    p, stderr = estimate_mean(estimate_batches(name)[..., :N_BINS])
    error = 4.0 * stderr.max(axis=(0, 1))
    assert (np.abs(p) <= p[0, 0] + error).all()
    assert (np.abs(p[2, 2] - p[3, 3]) <= p[0, 0] - p[1, 1] + error).all()
    larger = np.hypot(p[0, 1] + p[1, 0], np.hypot(p[2, 2] + p[3, 3], p[2, 3] - p[3, 2]))
    assert (larger <= p[0, 0] + p[1, 1] + error).all()
    slack = (p[0, 0] + p[1, 1] - larger) / p[0, 0]
    print(
        f"{name}: smallest slack {slack.min():+.4f} P11, errors below {(error / p[0, 0]).max():.4f}"
    )


@pytest.mark.parametrize("name", MEDIA)
def test_six_elements_are_those_of_single_scattering(name):
    """Means of the elements over all directions, from other rays."""
    medium, wavelength = MEDIA[name]
    ds = splits.single_scattering(medium, [wavelength], moments=2, rays=200_000, stokes=True)
    ds = ds.squeeze("wavelength")
    # Each angle stands for the linear function of the cosine that is 1 there, as in that dataset.
    width = np.abs(np.diff(np.cos(np.radians(ds.angle_deg.values))))
    weight = 0.25 * (np.append(width, 0.0) + np.append(0.0, width))
    batches, z = estimate_batches(name)[..., :N_BINS].sum(axis=-1), []
    for element in ("P12", "P33", "P34", "P22", "P44"):
        total, stderr = estimate_mean(batches[:, int(element[1]) - 1, int(element[2]) - 1])
        value = float((weight * ds[element]).sum())
        other = float(np.sqrt(((weight * ds[f"{element}_stderr"]) ** 2).sum()))
        print(f"{name}, {element}: {total:+.5f}, {value:+.5f} ± {np.hypot(stderr, other):.5f}")
        z.append((total - value) / np.hypot(stderr, other))
    # Errors of angles are taken as independent.  The normalization makes those of P22 smaller.
    judge_z(z, f"single scattering, {name}", bound_added=True)
