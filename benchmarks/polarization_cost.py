"""Cost of polarization: time per path segment, error against time, and weights on scalar paths.

    python benchmarks/polarization_cost.py [--quick]

1. Time per path segment, each of which ends with a collision or at a boundary, of polarized and of
   scalar rays, in alternating runs on one thread.  The scalar kernel traces polarized rays; without
   polarization grains have a vectorized kernel, too.
2. Standard error of the degree of linear polarization √(Q² + U²)/I of one bin of a snow pack.
3. Rays could follow scalar paths and carry the Stokes vector as a weight: the factor of a
   reflection is (R₊ + R₋ q)/R₊, that of a refraction (T₊ + T₋ q)/T₊.  The mean weight is 1.  Its
   second moment on scalar paths is its mean on polarized paths, whose probability is the weight
   times that of scalar ones.  Rays hit one smooth grain of clear ice after another.
"""

import argparse

import numpy as np
from numba import njit

import splits
from splits.kernels.arithmetic import UP
from splits.kernels.grains.grain_path import sample_entry_variates, sample_grain
from splits.kernels.grains.spheroid import compute_chord, sample_entry_point
from splits.kernels.grains.surface import (
    InterfaceState,
    make_smooth_facet,
    reflect_or_refract,
    relative_index,
)
from splits.kernels.interface import (
    ComplexIndex,
    apply_mueller,
    compute_mueller,
    rotate_to_plane_of_incidence,
)
from splits.kernels.rng import start_stream, uniform
from splits.kernels.scene import ALL_FEATURES, NO_MAX_ORDER, make_bounding_optics
from splits.kernels.stokes import UNPOLARIZED
from splits.kernels.tallies.exits import N_STOKES_COLUMNS, allocate_exits
from splits.kernels.transport import history
from splits.simulation.scene import IncidentPolarization, build_scene, compute_optical_constants

RAYLEIGH = {
    "optical_thickness": 10.0, "phase_function": "rayleigh", "single_scattering_albedo": 0.99,
}  # fmt: skip
MEDIA = {
    "snow, 600 nm": (splits.Snow(depth_m=0.02), 600.0),
    "sand, 650 nm": (splits.Sand(depth_m=0.005), 650.0),
    "particles": (splits.ParticleLayer(**RAYLEIGH), 600.0),
}
INCIDENCE_DEG = 60.0
REPEATS = 5
EVENT_COUNTS = np.array([1, 2, 5, 10, 20, 50, 100, 150, 200, 300, 400])


def run(medium, wavelength: float, rays: int, **settings):
    """Return bins of a medium, traced on one thread."""
    return splits.goniophotometer(
        medium, [wavelength], INCIDENCE_DEG, rays=rays, estimator="bins", n_bins=(4, 8), threads=1,
        **settings,
    )  # fmt: skip


def count_segments(medium, wavelength: float, stokes: bool, rays: int = 2000) -> float:
    """Return the mean number of path segments of a ray."""
    scene = build_scene(medium, INCIDENCE_DEG, False, stokes)
    constants = compute_optical_constants(medium, np.array([wavelength]))
    optics = make_bounding_optics(constants.indices[0], constants.absorption)
    n_stokes = 0 if scene.stokes is None else N_STOKES_COLUMNS
    exits = allocate_exits(rays, optics.n.size, n_stokes)
    work = np.array([0, 0, rays, NO_MAX_ORDER])
    return float(history.trace_rays(1, work, scene, optics, exits, None).n_segments[0]) / rays


def compare_costs(rays: int) -> None:
    """Print times per segment of polarized and scalar runs, and ratios of times per ray."""
    for name, (medium, wavelength) in MEDIA.items():
        if medium.has_grains:
            variants = {
                "polarized": (medium, {"stokes": True}),
                "scalar kernel": (medium, {"kernel": "scalar"}),
                "vectorized kernel": (medium, {"kernel": "vectorized"}),
            }
        else:
            polarized = splits.ParticleLayer(**RAYLEIGH, polarized=True)
            variants = {"polarized": (polarized, {}), "scalar kernel": (medium, {})}
        times: dict[str, list[float]] = {variant: [] for variant in variants}
        for repeat in range(REPEATS + 1):
            for variant, (one, settings) in variants.items():
                ds = run(one, wavelength, rays, seed=repeat, **settings)
                # The first run may compile.
                if repeat > 0:
                    times[variant].append(1e9 * float(ds.attrs["wall_time_s"]) / rays)
        for variant, values in times.items():
            one, settings = variants[variant]
            segments = count_segments(one, wavelength, settings.get("stokes", False))
            low, middle, high = np.quantile(values, [0.0, 0.5, 1.0]) / segments
            ratios = np.array(times["polarized"]) / np.array(values)
            print(
                f"{name}, {variant}: {segments:.0f} segments per ray, {middle:.0f} ns per segment "
                f"({low:.0f} to {high:.0f}); polarized takes {np.median(ratios):.2f} times as long "
                f"({ratios.min():.2f} to {ratios.max():.2f})",
                flush=True,
            )


def compare_errors(rays: list[int]) -> None:
    """Print the error of the degree of linear polarization of one bin against time."""
    medium, wavelength = MEDIA["snow, 600 nm"]
    for count in rays:
        ds = run(medium, wavelength, count, stokes=True, seed=7).isel(
            wavelength=0, polar=2, azimuth=0
        )
        q, u, i = (float(ds[name]) for name in ("brdf_q", "brdf_u", "brdf"))
        degree = np.hypot(q, u) / i
        errors = [float(ds[f"{name}_stderr"]) for name in ("brdf_q", "brdf_u", "brdf")]
        stderr = np.hypot(
            np.hypot(q * errors[0], u * errors[1]) / np.hypot(q, u) / i, degree * errors[2] / i
        )
        time = float(ds.attrs["wall_time_s"])
        print(
            f"{count} rays, {time:.2f} s: degree of linear polarization {degree:.5f} ± "
            f"{stderr:.5f}, error times root of time {stderr * time**0.5:.5f}",
            flush=True,
        )


@njit
def _sample_event(state, d, stokes, grain, side, index, polarized_paths):
    """Return direction, polarization, transmission and weight factor of an interaction."""
    ice, air = ComplexIndex(index, 0.0), ComplexIndex(1.0, 0.0)
    media = relative_index(air, ice) if side > 0.0 else relative_index(ice, air)
    facet = make_smooth_facet(d, grain, side)
    light = rotate_to_plane_of_incidence(d, stokes, facet.normal)
    mueller = compute_mueller(media.m, media.m_minus_1, 0.0, facet.cos_facet)
    reflection, transmission = mueller.reflection, mueller.transmission
    reflectance = reflection.plus
    if polarized_paths:
        reflectance += reflection.minus * light.q
    u = 0.0 if uniform(state) < reflectance else 1.0
    interface = InterfaceState(0.0, side, False, False)
    result = reflect_or_refract(d, interface, facet, media, u, True, ALL_FEATURES)
    if result.transmitted:
        factor = 1.0 + transmission.minus / transmission.plus * light.q
        return (
            result.direction, apply_mueller(result.direction, light, transmission), True, factor
        )  # fmt: skip
    factor = 1.0 + reflection.minus / reflection.plus * light.q
    return result.direction, apply_mueller(result.direction, light, reflection), False, factor


@njit
def tally_weights(n_rays, counts, scene, index, polarized_paths):
    """Return sums over rays of the weight and of its square after given numbers of events."""
    sums, state = np.zeros((2, counts.size)), np.zeros(1, dtype=np.uint64)
    for number in range(n_rays):
        start_stream(state, 1, 0, number)
        d, stokes, weight, row, n_events = UP, UNPOLARIZED, 1.0, 0, 0
        while row < counts.size:
            sample = sample_grain(state, scene, 0)
            variates = sample_entry_variates(state, sample.size)
            grain = sample_entry_point(d, sample.size, variates, scene.rules.entry_sampling).grain
            side = 1.0
            while row < counts.size:
                d, stokes, transmitted, factor = _sample_event(
                    state, d, stokes, grain, side, index, polarized_paths
                )
                weight *= factor
                n_events += 1
                if n_events == counts[row]:
                    sums[0, row] += weight
                    sums[1, row] += weight * weight
                    row += 1
                if (side > 0.0) != transmitted:
                    break
                side = -1.0
                grain = compute_chord(grain, d).grain
    return sums


def compare_weights(rays: int) -> None:
    """Print the second moment of the weight on scalar paths against the number of events."""
    medium = splits.Snow(facetness=(0.0,) * 4, saturation=0.0)
    scene = build_scene(medium, 0.0, False, IncidentPolarization())
    counts = EVENT_COUNTS
    on_scalar = tally_weights(rays, counts, scene, 1.31, False) / rays
    on_polarized = tally_weights(rays, counts, scene, 1.31, True) / rays
    for row, count in enumerate(counts):
        second = on_polarized[0, row]
        error = max(second - 1.0, 0.0) ** 0.5
        print(
            f"{count} events: mean weight {on_scalar[0, row]:.4f}, its square on scalar paths "
            f"{on_scalar[1, row]:.3f}, by polarized paths {second:.3f}; rms error of a ray "
            f"{error:.2f}, of 1e6 rays {error / 1e3:.1e}"
        )
    late = counts >= 50
    rate = np.polyfit(counts[late], np.log(on_polarized[0, late]), 1)[0]
    print(f"growth of the second moment from 50 events on: exp({rate:.4f} N)")


def main() -> None:
    """Print the three comparisons."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer rays")
    is_quick = parser.parse_args().quick
    compare_costs(20_000 if is_quick else 40_000)
    compare_errors([10_000, 40_000, 160_000] if is_quick else [10_000, 40_000, 160_000, 640_000])
    compare_weights(100_000 if is_quick else 400_000)


if __name__ == "__main__":
    main()
