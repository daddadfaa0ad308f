"""Coated grains, one at a time: slabs that add up, matched coatings, opaque cores, roulette."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from chi2 import NEEDS_JIT, draw_samples, judge_z
from events import play_roulette, trace_grain
from numba import njit
from scenes import make_coated_grains, make_optics, make_scene, sample_pore
from scipy import integrate

import splits
from splits.kernels.grains.spheroid import GrainSize
from splits.kernels.math.vectors import Vector, dot

pytestmark = NEEDS_JIT

RADIUS = 2.5e-4
COUNT = 100_000
CORE, COAT = 2, 3
OPAQUE = 1e15


@njit
def _walk(state, psi, facetness, scene, optics, true_absorption, length):
    """Return cosθ of scattering, paths in core and coatings, the score and the pore of exit.

    Roulette is played where the grain is left.
    """
    d = Vector(0.48, -0.64, 0.6)
    size = GrainSize(RADIUS, 1.0 - psi * psi)
    walk, _ = trace_grain(state, d, size, facetness, False, scene, optics, length)
    score = play_roulette(state, walk)
    if not scene.rules.analog:
        score *= math.exp(-(true_absorption * length).sum())
    pore = float(sample_pore(walk.payload.pore_variate, scene))
    return dot(d, walk.payload.direction), length[2], length[3:].sum(), score, pore


def layered(thickness, materials=None):
    """Return a table of one type with coatings of given relative thickness, from the outside."""
    return make_coated_grains(thickness, [*(materials or range(COAT, COAT + len(thickness))), CORE])


def walk(
    grains, index, absorption, psi=1.0, facetness=0.0, saturation=0.0,
    entry="projected", analog=False, heard=1.0, ray=0,
):  # fmt: skip
    """Draw walks; roulette uses the part `heard` of the absorption."""
    index = np.array([1.0, 1.33, *index], dtype=complex)
    absorption = np.array([0.0, 0.0, *absorption], dtype=float)
    optics = make_optics(index.real, index.imag, heard * absorption)
    rules = splits.SandInterpretation(entry_point=entry).to_sampling_rules(analog)
    scene = make_scene(grains, saturation=saturation, rules=rules)
    return draw_samples(
        _walk, COUNT, psi, facetness, scene, optics, absorption, np.zeros(index.size),
        width=5, ray=ray,
    )  # fmt: skip


def moments(sample):
    """Return what two samples of walks are compared by, one column each."""
    cosine, core, coat, score, pore = sample.T
    core, coat = core / RADIUS, coat / RADIUS
    # Grazing legs give the path through a coating no finite variance: hence its exponential.
    thin = np.exp(-20.0 * coat)
    return np.stack([
        cosine, cosine**2, core, core**2, thin, thin**2, thin * core, score, score * cosine,
        score**2, pore,
    ])  # fmt: skip


def difference(one, other):
    """Return z of every moment, where there is anything to compare."""
    a, b = moments(one), moments(other)
    error = np.sqrt((a.var(axis=1) + b.var(axis=1)) / COUNT)
    return (a.mean(axis=1) - b.mean(axis=1))[error > 0.0] / error[error > 0.0]


def fresnel(m1, m2, i):
    """Return unpolarized reflectance and angle of refraction, the near side by its real index."""
    m1 = complex(m1.real)
    c1, c2 = math.cos(i), cmath.sqrt(1.0 - (m1 * math.sin(i) / m2) ** 2)
    s = (m1 * c1 - m2 * c2) / (m1 * c1 + m2 * c2)
    p = (m2 * c1 - m1 * c2) / (m2 * c1 + m1 * c2)
    angle = math.atan2(m1.real * math.sin(i), (m2 * c2).real)
    return 0.5 * (abs(s) ** 2 + abs(p) ** 2), angle


def stack(m, depth, i):
    """Return the share that a stack of slabs on an opaque body sends back, order by order.

    `depth` are the optical thicknesses across.  Of (1 − r) that enter a slab, T² R comes back up
    to its top from below, which returns r' of it, and so on: a geometric series per slab.
    """
    r, t = fresnel(m[0], m[1], i)
    if len(m) == 2:
        return r
    back, _ = fresnel(m[1], m[0], t)
    below = stack(m[1:], depth[1:], t) * math.exp(-2.0 * depth[0] / math.cos(t))
    return r + (1.0 - r) * (1.0 - back) * below / (1.0 - back * below)


def over_impacts(value, entry="projected"):
    """Return the mean of value(i) over angles of incidence on a sphere."""

    def integrand(i):
        return value(i) * (math.sin(2.0 * i) if entry == "projected" else math.sin(i))

    return integrate.quad(integrand, 0.0, 0.5 * math.pi, limit=400)[0]


@pytest.mark.parametrize("facetness", [0.0, 0.5])
def test_two_coatings_of_one_material_are_one(facetness):
    """Between equal materials no facet reflects or bends: legs h₁/|n·d| and h₂/|n·d| add up."""
    z = []
    for number, (h1, h2, coat) in enumerate(
        [(0.004, 0.004, 1.7), (0.001, 0.02, 1.3), (0.03, 0.01, 2.2 + 0.1j)]
    ):
        setting = {"index": [1.55, coat], "absorption": [200.0, 3e4], "psi": 0.8}
        setting |= {"facetness": facetness, "saturation": 0.4}
        grains = layered([h1, h2], [COAT, COAT]), layered([h1 + h2])
        # No roulette where weights are compared: it ends walks.
        two, one = (walk(g, **setting, heard=0.0, ray=2 * number + i) for i, g in enumerate(grains))
        assert one[:, 2].max() > 0.0
        z.append(difference(two, one))
        two, one = (
            walk(g, **setting, analog=True, ray=120 + 2 * number + i) for i, g in enumerate(grains)
        )
        survived = np.array([two[:, 3].mean(), one[:, 3].mean()])
        error = np.sqrt((survived * (1.0 - survived)).sum() / COUNT)
        z.append([(survived[0] - survived[1]) / error])
    # Moments of a pair of samples are correlated.
    judge_z(np.concatenate(z), f"two coatings, facetness {facetness}", independent=len(z))


@pytest.mark.parametrize("facetness", [0.0, 0.5])
def test_a_clear_coating_of_the_cores_index_changes_nothing(facetness):
    """Holds for rough grains, too: facets of a matched interface do not refract."""
    z = []
    for number, (psi, core) in enumerate([(1.0, 1.31), (0.7, 1.55 + 0.05j)]):
        setting = {"psi": psi, "facetness": facetness, "saturation": 0.4}
        bare = walk(layered([]), [core], [3000.0], **setting, ray=10 + number)
        coated = walk(layered([0.01]), [core, core], [3000.0, 0.0], **setting, ray=20 + number)
        assert (bare[:, 2] == 0.0).all() and coated[:, 2].max() > 0.0
        coated[:, 2] = 0.0
        z.append(difference(bare, coated))
    judge_z(np.concatenate(z), f"matched coating, facetness {facetness}", independent=len(z))


def test_paths_in_the_coating_are_the_slabs():
    """All indices alike: a chord 2R cos i, and before and after it a leg h/cos i each."""
    sample = walk(layered([0.01]), [1.0, 1.0], [0.0, 0.0])
    cosine, core, coat, score, _ = sample.T
    assert np.abs(cosine - 1.0).max() < 1e-12 and (score == 1.0).all()
    np.testing.assert_allclose(core * coat, 8.0 * RADIUS**2 * 0.01, rtol=1e-6)
    judge_z([(core.mean() / RADIUS - 4 / 3) / (core.std() / RADIUS / math.sqrt(COUNT))], "chord")


# Of several films all are clear to Fresnel: planes of real phase do not come back from below an
# absorbing film at the angle at which they went down.
STACKS = {
    "absorbing film": ([1.56, 2.0 + 1.5j], [0.7], [0.004]),
    "bright core": ([1.56, 0.2 + 6.0j], [0.3], [0.004]),
    "dark film": ([2.8 + 0.6j, 1.5 + 2.0j], [0.4], [0.004]),
    "two films": ([1.4, 2.2, 0.3 + 4.0j], [0.2, 0.4], [0.003, 0.006]),
    "three films": ([1.4, 2.2, 1.6, 0.3 + 4.0j], [0.2, 0.1, 0.3], [0.002, 0.01, 0.001]),
}  # fmt: skip


@pytest.mark.parametrize("entry", ["projected", "uniform"])
def test_coated_opaque_cores(entry):
    """All orders of reflection between films and core, by quadrature over impacts."""
    z = []
    for number, (index, depth, thickness) in enumerate(STACKS.values()):
        m = [complex(v) for v in (1.0, *index)]
        expected = over_impacts(lambda i, m=m, depth=depth: stack(m, depth, i), entry)
        absorption = [OPAQUE, *np.array(depth) / (2.0 * RADIUS * np.array(thickness))]
        for analog in (False, True):
            score = walk(
                layered(thickness), [index[-1], *index[:-1]], absorption,
                entry=entry, analog=analog, ray=30 + 2 * number + analog,
            )[:, 3]  # fmt: skip
            z.append((score.mean() - expected) / (score.std() / math.sqrt(COUNT)))
    judge_z(z, f"coated opaque cores, {entry}")


@pytest.mark.parametrize("entry", ["projected", "uniform"])
def test_pure_magnetite_reflects_its_fresnel_share(entry):
    sand = splits.Sand(
        iron_oxide=0.0,
        magnetite=1.0,
        partition=(1, 0, 0),
        sphericity=(1, 1, 1, 0),
        roundness=(1, 0),
    )
    z = []
    for number, wavelength in enumerate((400.0, 700.0, 1000.0)):
        index = complex(sand.compute_refractive_indices([wavelength])[0, CORE])
        absorption = 4.0 * math.pi * index.imag / (wavelength * 1e-9)
        expected = over_impacts(lambda i, m=index: fresnel(1.0 + 0j, m, i)[0], entry)
        for analog in (False, True):
            score = walk(
                sand.make_grain_population(), [index], [absorption],
                entry=entry, analog=analog, ray=60 + 2 * number + analog,
            )[:, 3]  # fmt: skip
            assert analog or set(np.unique(score[score > 1e-12])) == {1.0}
            error = math.sqrt(expected * (1.0 - expected) / COUNT)
            z.append((score.mean() - expected) / error)
    judge_z(z, f"magnetite, {entry}")


@pytest.mark.parametrize("facetness", [0.0, 0.5])
def test_roulette_in_coatings_is_fair(facetness):
    """Weights times Lambert's factor score what coins do, even where roulette is overeager.

    It stays fair with absorption taken `heard` times too high, from 2 on with infinite variance.
    """
    z = []
    for number, (core, coat, heard) in enumerate([(0.5, 1.0, 1.0), (1.0, 0.2, 1.8), (0, 0.5, 1.8)]):
        grains, index = layered([0.005, 0.01]), [1.55, 2.2 + 0.05j, 1.3]
        absorption = np.array([core, 100.0 * coat, 10.0 * coat]) / (2.0 * RADIUS)
        setting = {"psi": 0.8, "facetness": facetness, "saturation": 0.3}
        played, never, coins = (
            walk(grains, index, absorption, **setting, **how, ray=80 + 3 * number + i)
            for i, how in enumerate(({"heard": heard}, {"heard": 0.0}, {"analog": True}))
        )
        # The longest fifth of the walks by itself, too: only they see roulette.
        least = np.quantile(never[:, 1:3].sum(axis=1), 0.8)
        far = [s[:, 3] * (s[:, 1:3].sum(axis=1) > least) for s in (played, never)]
        scores = played[:, 3], never[:, 3], coins[:, 3]
        for one, other in (far, scores[:2], scores[1:]):
            z.append((one.mean() - other.mean()) / np.sqrt((one.var() + other.var()) / COUNT))
    judge_z(z, f"roulette, facetness {facetness}", independent=3)
