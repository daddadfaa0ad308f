"""The vectorized kernel against the scalar one, and reproducibility across lanes and jobs."""

import random
import time

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compute_pooled_z, judge_z
from numba import njit
from numpy import float32 as single
from scenes import make_medium_scene, to_single_item

import splits
from splits.kernels import vectorized
from splits.kernels.grains.spheroid import Spheroid
from splits.kernels.grains.surface import RelativeIndex
from splits.kernels.interface import ComplexIndex
from splits.kernels.records import EXIT_DIRECTION, EXIT_POSITION, allocate_exits
from splits.kernels.scene import NO_MAX_ORDER, Features, Optics, Vector
from splits.kernels.vectorized import lanes
from splits.kernels.vectorized.lanes import (
    N_LANES,
    Lane,
    Material,
    Pore,
)
from splits.kernels.vectorized.passes import run_surface_pass
from splits.simulation.engine import simulate
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import build_scene
from splits.simulation.shared_paths import PathSharingMedia, SpectralRows
from splits.simulation.spectral_nodes import make_separate_nodes
from splits.simulation.spectral_tally import SINGLE_STRATUM, SpectralTally
from splits.simulation.strata import StoppingRule
from splits.simulation.tally import RAYS_PER_CHUNK

pytestmark = NEEDS_JIT

RAYS = 50_000
"""Number of rays per wavelength and kernel; 20 wavelengths give a million for each medium."""
SNOW = np.linspace(400.0, 2500.0, 20)
SAND = np.linspace(400.0, 1000.0, 20)
MEDIA = {
    "representative snow": (splits.Snow(), 0.0, SNOW),
    "coarse wet snow": (splits.Snow(grain_size_um=(900, 1000), saturation=0.3), 45.0, SNOW),
    "thin layer": (splits.Snow(depth_m=0.02, grain_size_um=(100, 200), saturation=0), 75.0, SNOW),
    "smooth dry snow": (splits.Snow(facetness=(0, 0, 0, 0), saturation=0), "diffuse", SNOW),
    "coated sand": (splits.Sand(), 0.0, SAND),
    "wet sand of all types": (
        splits.Sand(partition=(0.3, 0.3, 0.4), magnetite=0.02, saturation=0.4), 30.0, SAND,
    ),
}  # fmt: skip


def make_tally(medium, wavelengths, scene):
    """Return a tally with a separate ensemble of paths for each wavelength."""
    rows = SpectralRows.from_media(PathSharingMedia.from_media([medium]), wavelengths)
    return SpectralTally(rows, make_separate_nodes(rows.index), scene, SINGLE_STRATUM)


def trace_spectrum(medium, incidence, wavelengths, kernel, seed, rays=RAYS):
    """Return R and T, their standard errors, and the seconds elapsed on two threads."""
    scene = build_scene(medium, incidence, False)
    tally = make_tally(medium, wavelengths, scene)
    # Each wavelength with the features that it needs.
    tally.shares_kernel = False
    stop = StoppingRule(0.0, rays * len(wavelengths), fixed=True)
    start = time.perf_counter()
    simulate(scene, tally, stop, RunOptions.start(seed, 2, kernel))
    seconds = time.perf_counter() - start
    assert tally.kernel == kernel
    assert (tally.count_rays() == -(-rays // RAYS_PER_CHUNK) * RAYS_PER_CHUNK).all()
    error = np.sqrt(tally.compute_variances()[:2])
    return tally.compute_means()[:2], error, seconds


@pytest.mark.long
def test_vectorized_kernel_agrees_with_scalar_kernel():
    samples = {"reflectance": [], "transmittance": []}
    for number, (name, (medium, incidence, wavelengths)) in enumerate(MEDIA.items()):
        scalar, scalar_error, scalar_seconds = trace_spectrum(
            medium, incidence, wavelengths, "scalar", 100 + number
        )
        vector, vector_error, vector_seconds = trace_spectrum(
            medium, incidence, wavelengths, "vectorized", 200 + number
        )
        print(
            f"{name}: scalar {scalar_seconds:.1f} s, vectorized {vector_seconds:.1f} s, "
            f"ratio {scalar_seconds / vector_seconds:.1f}"
        )
        # Counts of very few transmitted rays are not normally distributed.  A separate run selects
        # the wavelengths with enough rays, so that the selection does not bias the test.
        selection, _, _ = trace_spectrum(
            medium, incidence, wavelengths, "vectorized", 300 + number, RAYS // 5
        )
        well_counted = selection > 100.0 / RAYS
        error = np.hypot(scalar_error, vector_error)
        for row, quantity in enumerate(samples):
            columns = [
                a[row, well_counted[row]] for a in (vector - scalar, error, 0.5 * (vector + scalar))
            ]
            samples[quantity].append(columns)
            if well_counted[row].any():
                judge_z(columns[0] / columns[1], f"{quantity} of {name}")
    pooled = []
    for quantity, parts in samples.items():
        difference, error, value = (np.concatenate(column) for column in zip(*parts, strict=True))
        judge_z(difference / error, f"{quantity}, vectorized against scalar")
        # Wavelengths use separate rays.  Both means detect a common bias, absolute or relative.
        pooled += [compute_pooled_z(difference, error), compute_pooled_z(difference, error, value)]
        relative_error = 1.0 / np.sqrt(((value / error) ** 2).sum())
        print(
            f"{quantity}: vectorized over scalar 1 {pooled[-1] * relative_error:+.1e} "
            f"± {relative_error:.0e}"
        )
    # Reflectance and transmittance of a run are correlated, as are both means of either.
    judge_z(pooled, "signed means, vectorized against scalar", independent=1)


def test_paths_are_independent_of_other_ensembles():
    scene = build_scene(splits.Snow(depth_m=0.02), 30.0, False)
    tally = make_tally(splits.Snow(), np.array([500.0, 800.0]), scene)
    strata = tally.strata
    tally.select_kernel(scene, "vectorized")
    ensemble_optics = [stratum.optics for stratum in strata]
    features = strata[0].features

    def trace_exits(items, optics):
        rows = allocate_exits(sum(rays for *_, rays, _ in items), 3)
        n_segments, lost, _ = vectorized.trace_rays(
            3, np.array(items), scene, optics, rows, features
        )
        assert not lost and n_segments.min() > 0
        return rows, n_segments

    items = [
        (0, 0, 101, NO_MAX_ORDER),
        (4, 50, 1, NO_MAX_ORDER),
        (4, 7, 300, NO_MAX_ORDER),
        (0, 200, 33, NO_MAX_ORDER),
    ]
    optics = [ensemble_optics[0], ensemble_optics[1], ensemble_optics[1], ensemble_optics[0]]
    joint, n_segments = trace_exits(items, Optics(*map(np.stack, zip(*optics, strict=True))))
    separate = [
        trace_exits([item], to_single_item(one)) for item, one in zip(items, optics, strict=True)
    ]
    assert np.array_equal(joint, np.concatenate([rows for rows, _ in separate]), equal_nan=True)
    assert n_segments.tolist() == [int(count[0]) for _, count in separate]


def test_paths_are_independent_of_lane_and_batch():
    medium = splits.Snow(depth_m=0.02)
    scene = build_scene(medium, 30.0, False)
    tally = make_tally(medium, np.array([900.0]), scene)
    tally.select_kernel(scene, "vectorized")
    (stratum,) = tally.strata

    def trace_exits(first, rays):
        rows = allocate_exits(rays, 3)
        work = np.array([[0, first, rays, NO_MAX_ORDER]])
        _, lost, _ = vectorized.trace_rays(
            3, work, scene, to_single_item(stratum.optics), rows, stratum.features
        )
        assert not lost
        return rows

    count = 5 * N_LANES + 7
    joint = trace_exits(0, count)
    separate = np.concatenate([trace_exits(ray, 1) for ray in range(count)])
    assert np.array_equal(joint, separate, equal_nan=True)


@pytest.mark.parametrize("kernel", ["vectorized", "scalar"])
@pytest.mark.parametrize("medium", [splits.Snow(depth_m=0.03), splits.Sand()], ids=["snow", "sand"])
def test_results_are_independent_of_threads_and_jobs(medium, kernel):
    wavelengths = np.array([650.0, 900.0])
    batches = 12

    def make_selected_tally(scene):
        tally = make_tally(medium, wavelengths, scene)
        tally.select_kernel(scene, kernel)
        return tally

    def get_sums(tally):
        return np.concatenate([tally.moments.ravel(), tally.batch_sums.ravel()])

    def trace_sums(threads=None):
        scene = build_scene(medium, 10.0, False)
        tally = make_tally(medium, wavelengths, scene)
        stop = StoppingRule(0.0, batches * RAYS_PER_CHUNK * len(wavelengths), fixed=True)
        simulate(scene, tally, stop, RunOptions.start(4, threads, kernel))
        assert tally.n_rays == stop.max_rays
        return get_sums(tally)

    def merge_jobs(jobs):
        """Return the ordered sums of jobs that trace every `jobs`-th chunk."""
        scores = {}
        for job in random.Random(1).sample(range(jobs), jobs):
            scene = build_scene(medium, 10.0, False)
            tally = make_selected_tally(scene)
            for number, stratum in enumerate(tally.strata):
                for batch in range(job, batches, jobs):
                    first_ray = batch * RAYS_PER_CHUNK
                    item = (stratum, range(first_ray, first_ray + RAYS_PER_CHUNK))
                    (((score,), _),) = tally.trace_job(4, scene, [item])
                    scores[number, batch] = score
        tally = make_tally(medium, wavelengths, scene)
        for (number, _), score in sorted(scores.items(), key=lambda item: item[0]):
            tally.merge(tally.strata[number], score)
            tally.strata[number].n_rays += RAYS_PER_CHUNK
        return get_sums(tally)

    expected = trace_sums(1)
    for other in (trace_sums(2), trace_sums(4), merge_jobs(1), merge_jobs(7)):
        assert (other == expected).all()


def test_vectorized_kernel_conserves_energy():
    medium = splits.Snow(
        saturation=0.2, depth_m=0.01, refractive_index={"ice": 1.31, "water": 1.33}
    )
    scene = build_scene(medium, 60.0, False)
    tally = make_tally(medium, np.array([600.0]), scene)
    tally.select_kernel(scene, "vectorized")
    (stratum,) = tally.strata
    rows = allocate_exits(3000, 3)
    work = np.array([[0, 0, 3000, NO_MAX_ORDER]])
    _, lost, _ = vectorized.trace_rays(
        5, work, scene, to_single_item(stratum.optics), rows, stratum.features
    )
    assert not lost
    assert (rows[:, 0] >= 0.0).all()
    directions = rows[:, EXIT_DIRECTION : EXIT_DIRECTION + 3]
    assert np.abs((directions**2).sum(axis=1) - 1.0).max() < 1e-6
    assert ((directions[:, 2] > 0.0) == (rows[:, 0] == 0.0)).all()
    assert (rows[:, 1] == 1.0).all()
    assert np.isfinite(rows[:, EXIT_POSITION : EXIT_POSITION + 2]).all()


@njit
def put_inside_grains(state, qx, qy, qz, dx, dy, dz):
    """Put the rays of all lanes at points of the surfaces of spheres, on their inner sides."""
    zero, one = single(0.0), single(1.0)
    m_in, m_out = single(1.31), single(1.0 / 1.31)
    for i in range(N_LANES):
        lane = Lane(state, i)
        lane.status, lane.shell, lane.side = lanes.AT_SURFACE, one, -one
        lane.grain = Spheroid(
            Vector(qx[i], qy[i], qz[i]), Vector(zero, zero, one), zero, single(1e-4)
        )
        lane.direction = Vector(dx[i], dy[i], dz[i])
        lane.dry = Pore(
            Material(ComplexIndex(one, zero), zero),
            RelativeIndex(m_in, single(0.31), zero, m_out, False),
            RelativeIndex(m_out, single(-0.31 / 1.31), zero, m_in, False),
        )


def get_rows(state, name):
    """Return the rows of the state of lanes from a field on."""
    return state.view(single).reshape(-1, N_LANES)[Lane.fields[name].row :]


def test_rounding_does_not_drift_into_total_reflection():
    # Just within total reflection all rays stay inside; rounding may only drift outwards.
    passes, cosine = 20_000, 0.64
    state = np.zeros(lanes.STATE_SIZE, dtype=np.uint32)
    generator = np.random.default_rng(1)
    q = generator.normal(size=(3, N_LANES))
    q /= np.linalg.norm(q, axis=0)
    t = np.cross(q.T, generator.normal(size=(N_LANES, 3))).T
    t /= np.linalg.norm(t, axis=0)
    d = cosine * q + np.sqrt(1.0 - cosine**2) * t

    put_inside_grains(state, *q.astype(single), *d.astype(single))
    rules = make_medium_scene(splits.Snow(saturation=0.0)).rules

    def cosines():
        q, d = (get_rows(state, name)[:3].astype(float) for name in ("grain", "direction"))
        return (q * d).sum(axis=0) / np.linalg.norm(q, axis=0) / np.linalg.norm(d, axis=0)

    before = cosines()
    for _ in range(passes):
        run_surface_pass(state, N_LANES, Features(*[None] * len(Features._fields)), rules)
    assert (get_rows(state, "shell")[0] == 1.0).all()
    drift = (cosines() - before) / passes
    error = drift.std(ddof=1) / np.sqrt(N_LANES)
    print(f"drift of the cosine per reflection {drift.mean():.1e} ± {error:.0e}")
    assert -3.0 * error < drift.mean() < 1e-7
