"""Agreement of both kernels with the oracle, an independent scalar kernel.

All of them trace at the same refractive indices, with one index node per wavelength, so that the
results do not depend on interpolation.
"""

import time

import numpy as np
import pytest
from chi2 import NEEDS_JIT, compute_pooled_z, compute_z_bound, judge_z
from oracle import granular as oracle_granular
from scenes import compute_optics, make_medium_scene, make_oracle_slab

import splits
from splits.kernels import vectorized
from splits.kernels.records import (
    EXIT_LENGTH,
    EXIT_SIDE,
    EXIT_WEIGHT,
    allocate_exits,
)
from splits.kernels.scene import NO_MAX_ORDER, Optics
from splits.kernels.transport import history
from splits.kernels.vectorized.trace import select_features

pytestmark = [NEEDS_JIT, pytest.mark.long]

SNOW = np.linspace(400.0, 2500.0, 20)
SAND = np.linspace(400.0, 1000.0, 20)
SMOOTH = (0.0, 0.0, 0.0, 0.0)
OTHER_INTERPRETATION = {
    "entry_point": "projected",
    "facet_sampling": "any",
    "wrong_side_ray": "mirror",
    "boundary_fresnel": "no",
    "overlap_with_previous_segment": "keep",
    "overlap_with_boundary": "skip",
}
# Medium, incidence, rays per wavelength.
MEDIA = {
    "snow": (splits.Snow(depth_m=0.03), 0.0, 2000),
    "dry snow": (splits.Snow(depth_m=0.02, saturation=0.0), 0.0, 2000),
    "smooth snow": (splits.Snow(depth_m=0.02, facetness=SMOOTH), 0.0, 2000),
    "thin wet snow": (splits.Snow(depth_m=0.002, saturation=0.5), 0.0, 8000),
    "coarse wet snow": (
        splits.Snow(depth_m=0.03, grain_size_um=(900, 1000), saturation=0.3), 0.0, 2000,
    ),
    "fine snow": (splits.Snow(depth_m=0.005, grain_size_um=(100, 200)), 0.0, 2000),
    "dense snow": (splits.Snow(depth_m=0.01, density_kg_m3=600.0), 0.0, 2000),
    "snow at 60 degrees": (splits.Snow(depth_m=0.01), 60.0, 3000),
    "snow by another interpretation": (
        splits.Snow(depth_m=0.01, saturation=0.3, interpretation=OTHER_INTERPRETATION), 30.0, 3000,
    ),
    "sand": (splits.Sand(depth_m=0.003), 0.0, 4000),
    "wet sand of eight types": (
        splits.Sand(
            depth_m=0.003, hematite_ratio=0.5, magnetite=0.05, saturation=0.4,
            partition=(0.3, 0.3, 0.4),
        ),
        30.0, 4000,
    ),
    "sand of coated grains only": (
        splits.Sand(depth_m=0.003, partition=(0.0, 0.0, 1.0), hematite_ratio=1.0), "diffuse", 4000,
    ),
}  # fmt: skip
KERNELS = ("vectorized", "scalar")


def get_wavelengths(medium):
    return SNOW if isinstance(medium, splits.Snow) else SAND


def compute_fluxes(exits, absorption):
    """Return reflectance and transmittance, and their standard errors, each of shape (2,)."""
    side, weight = exits[:, EXIT_SIDE], exits[:, EXIT_WEIGHT]
    exited = side >= 0.0
    score = np.zeros(len(exits))
    score[exited] = weight[exited] * np.exp(-exits[exited, EXIT_LENGTH:] @ absorption)
    scores = np.stack([np.where(side == row, score, 0.0) for row in (0.0, 1.0)])
    return scores.mean(axis=1), scores.std(axis=1) / np.sqrt(len(exits))


def compute_with_oracle(medium, incidence, optics, seed, rays):
    """Compute reflectance and transmittance with errors at each wavelength, with the oracle."""
    slab = make_oracle_slab(medium, incidence)
    fluxes = []
    for number, one in enumerate(optics):
        exits = allocate_exits(rays, one.n.size)
        work = np.array([number, 0, rays, NO_MAX_ORDER])
        _, lost = oracle_granular.trace_rays(seed, work, *slab, one, exits)
        assert not lost
        fluxes.append(compute_fluxes(exits, one.absorption))
    return np.array(fluxes)


def compute_with_kernel(kernel, medium, incidence, optics, seed, rays):
    """Compute reflectance and transmittance with errors at each wavelength, with a kernel."""
    scene = make_medium_scene(medium, incidence)
    work = np.array([[number, 0, rays, NO_MAX_ORDER] for number in range(len(optics))])
    exits = [allocate_exits(rays, one.n.size) for one in optics]
    if kernel == "scalar":
        for item, one, rows in zip(work, optics, exits, strict=True):
            assert not history.trace_rays(seed, item, scene, one, rows, None).lost
    else:
        features = [select_features(scene, one) for one in optics]
        assert None not in features
        # One set of compiled features serves all wavelengths.
        absorbing = any(one.absorbing for one in features) and not features[0].mixed
        shared = features[0]._replace(absorbing=True if absorbing else None)
        stacked_optics, rows = (
            Optics(*map(np.stack, zip(*optics, strict=True))),
            np.concatenate(exits),
        )
        assert not vectorized.trace_rays(seed, work, scene, stacked_optics, rows, shared).lost
        exits = np.split(rows, len(optics))
    pairs = zip(exits, optics, strict=True)
    return np.array([compute_fluxes(rows, one.absorption) for rows, one in pairs])


def test_kernels_agree_with_the_oracle():
    differences = {kernel: [] for kernel in KERNELS}
    for number, (name, (medium, incidence, rays)) in enumerate(MEDIA.items()):
        optics = [compute_optics(medium, wavelength) for wavelength in get_wavelengths(medium)]
        times_s = [time.perf_counter()]
        reference = compute_with_oracle(medium, incidence, optics, 700 + number, rays)
        times_s.append(time.perf_counter())
        for kernel in KERNELS:
            values = compute_with_kernel(kernel, medium, incidence, optics, 900 + number, rays)
            times_s.append(time.perf_counter())
            # Where hardly any ray is transmitted, the score is not normally distributed.  Both
            # estimates enter the selection equally, so that it does not bias the difference.
            significant = 0.5 * (values + reference)[:, 0] > 20.0 / rays
            error = np.hypot(values[:, 1], reference[:, 1])[significant]
            difference, value = (
                (values - reference)[:, 0][significant],
                reference[:, 0][significant],
            )
            differences[kernel].append((difference, error, value))
            z = (difference / error).round(1).tolist()
            print(f"{name}, {kernel}: {times_s[-1] - times_s[-2]:.1f} s, {z}")
        print(f"{name}, oracle: {times_s[1] - times_s[0]:.1f} s", flush=True)
    for kernel, parts in differences.items():
        difference, error, value = (np.concatenate(column) for column in zip(*parts, strict=True))
        z = difference / error
        rms = np.sqrt((z**2).mean())
        pooled = [compute_pooled_z(difference, error), compute_pooled_z(difference, error, value)]
        relative_error = 1.0 / np.sqrt(((value / error) ** 2).sum())
        print(
            f"{kernel}: {z.size} comparisons, rms z {rms:.2f}, pooled {pooled[0]:+.2f}, relative "
            f"{pooled[1]:+.2f}, 1 {pooled[1] * relative_error:+.1e} ± {relative_error:.0e}"
        )
        assert np.abs(z).max() <= compute_z_bound(z.size)
        assert 0.85 <= rms <= 1.15
        judge_z(pooled, f"signed means, {kernel}", independent=1)
