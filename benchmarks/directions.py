"""Directional reflectance and polarization: variance at equal time, reciprocity, and costs.

python benchmarks/directions.py {bins,local_estimation,forward_peaks,reciprocity,
    polarization_cost,polarization_error,weights,facetness} [--table TABLE.csv]
"""

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from command import run_command
from numba import njit

import splits
from splits.analysis.directions import select_principal_plane
from splits.instruments.angular_tallies import DEFAULT_N_BINS, compute_bin_centres
from splits.kernels import phase_function
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
from splits.kernels.records import N_STOKES_COLUMNS, allocate_exits
from splits.kernels.rng import start_stream, uniform
from splits.kernels.scene import ALL_FEATURES, NO_MAX_ORDER, UNPOLARIZED, UP, make_bounding_optics
from splits.kernels.transport import history
from splits.simulation.scene import IncidentPolarization, build_scene, compute_optical_constants

MAX_POLAR_DEG = 80.0
TABLE1 = splits.Snow()
SCENES = {
    "snow, 600 nm, 0 degrees": (TABLE1, 600.0, 0.0),
    "snow, 600 nm, 60 degrees": (TABLE1, 600.0, 60.0),
    "snow, 1800 nm, 69.3 degrees": (splits.Snow(depth_m=0.25), 1800.0, 69.3),
    "snow, 600 nm, 84.8 degrees": (splits.Snow(depth_m=0.25), 600.0, 84.8),
    "sand, 600 nm, 60 degrees": (splits.Sand(), 600.0, 60.0),
}


def time_call(call):
    """Return the dataset of a call and its time (s)."""
    start = time.perf_counter()
    dataset = call()
    return dataset, time.perf_counter() - start


def compute_cost(dataset: xr.Dataset, seconds: float) -> float:
    """Return the mean relative variance in the principal plane, times the time."""
    plane = select_principal_plane(dataset).isel(wavelength=0)
    plane = plane.isel(angle=np.abs(plane.angle.values) <= MAX_POLAR_DEG)
    mean = float(plane.brdf.mean())
    return seconds * float((plane.brdf_stderr**2).mean()) / mean**2


LAYERS = {
    "clear water over sand": {
        "optical_thickness": 1.0, "single_scattering_albedo": 0.8, "asymmetry": 0.9,
        "refractive_index": 1.34, "ground": 0.3,
    },
    "paint": {"optical_thickness": 20.0, "single_scattering_albedo": 0.99, "asymmetry": 0.6},
    "cloud": {
        "optical_thickness": 10.0, "single_scattering_albedo": 1.0, "asymmetry": 0.85,
        "refractive_index": 1.0, "ground": 0.1,
    },
    "polarizing paint": {
        "optical_thickness": 5.0, "single_scattering_albedo": 0.9, "phase_function": "rayleigh",
        "polarized": True,
    },
}  # fmt: skip
INCIDENCE_DEG = 60.0


PHASE_TABLE = Path(__file__).parents[1] / "tests" / "physics" / "reference" / "cloud_c1.csv"
PEAKED_LAYERS = {
    "thin cloud C.1": ({}, 4.0, 20_000),
    "Henyey-Greenstein, g = 0.95": ({"asymmetry": 0.95}, 8.0, 20_000),
    "Henyey-Greenstein, g = 0.99": ({"asymmetry": 0.99}, 8.0, 10_000),
    "cloud C.1": ({}, 64.0, 20_000),
}
POLAR_DEG = [30.0, 60.0, 82.0, 87.0]


def make_cloud_phase_function() -> dict[str, list[float]]:
    """Return the phase function of cloud C.1."""
    table = pd.read_csv(PHASE_TABLE, comment="#").sort_values("angle_deg", ascending=False)
    cosine = np.cos(np.radians(table.angle_deg.to_numpy()))
    cosine[[0, -1]] = -1.0, 1.0
    return {"cosine": cosine.tolist(), "density": table.density_per_sr.tolist()}


def measure_layer(
    layer: splits.ParticleLayer, rays: int, seeds: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return BRDF and BTDF of all seeds, their errors, and the time per ray (s)."""
    settings = {
        "polar_deg": POLAR_DEG,
        "azimuth_deg": [0.0],
        "estimator": "next_event",
        "threads": 1,
    }
    splits.goniophotometer(layer, [700.0], 0.0, rays=10, **settings)
    start = time.process_time()
    runs = [
        splits.goniophotometer(layer, [700.0], 0.0, rays=rays, seed=seed, **settings)
        for seed in range(seeds)
    ]
    time_per_ray_s = (time.process_time() - start) / (rays * seeds)
    value, stderr = (
        np.array([[run[name + end].values.ravel() for name in ("brdf", "btdf")] for run in runs])
        for end in ("", "_stderr")
    )
    return value, stderr, time_per_ray_s


ANGLE_PAIRS = ((0, 40, 0), (20, 70, 0), (20, 70, 180), (45, 75, 90), (60, 30, 180), (10, 80, 45))
"""Angle of incidence, viewing angle, azimuth from the forward direction (degrees)."""

KEEP_OVERLAPS = {"overlap_with_previous_segment": "keep", "overlap_with_boundary": "keep"}
SKIP_OVERLAPS = {"overlap_with_previous_segment": "skip", "overlap_with_boundary": "skip"}
INTERPRETATIONS = {
    "splits_2007": {},
    "entry projected": {"entry_point": "projected"},
    "all grains kept": KEEP_OVERLAPS,
    "skipped at boundaries": {"overlap_with_boundary": "skip"},
    "all skipped, entry projected": {**SKIP_OVERLAPS, "entry_point": "projected"},
    "the set geometric": {"set": "geometric"},
    "the set geometric, lobe": {"set": "geometric", "wrong_side_ray": "cosine_lobe"},
    "the set radiative_transfer": {"set": "radiative_transfer"},
    "the set radiative_transfer, lobe": {
        "set": "radiative_transfer",
        "wrong_side_ray": "cosine_lobe",
    },
}
DENSE_MEDIA = {
    "snow of Table 1, dry, 1300 nm": (splits.Snow, {"saturation": 0.0}, 1300.0),
    "sand, base case of Fig 8, 600 nm": (splits.Sand, {}, 600.0),
}


def bins(rays: int = 1_000_000, error: float = 0.02, repeats: int = 8) -> Iterator[dict[str, Any]]:
    """Variance of a BRDF by expansion in basis functions, compared with angular bins.

    For every case both estimators trace one wavelength on one thread.  `gain` is the stated
    variance times the computing time of bins over that of the expansion, averaged over the
    principal plane up to 80 degrees.  There are 18 × 72 bins of equal solid angle, as many as bins
    of 5° × 5°.  `scatter` is that between seeds over the stated error.  `rms_z` is that of the
    difference between the mean of all expansions and the bins.
    """
    polar, azimuth = compute_bin_centres(DEFAULT_N_BINS)
    grid = {"polar_deg": polar, "azimuth_deg": azimuth, "threads": 1}
    for name, scene in SCENES.items():
        scene = (scene[0], [scene[1]], scene[2])
        # The first calls compile.
        splits.goniophotometer(*scene, rays=1, **grid)
        splits.goniophotometer(*scene, rays=1, estimator="bins", **grid)
        binned, bins_s = time_call(
            lambda scene=scene: splits.goniophotometer(
                *scene, rays=rays, estimator="bins", n_bins=DEFAULT_N_BINS, threads=1
            )
        )
        runs, run_s = time_call(
            lambda scene=scene: [
                splits.goniophotometer(*scene, seed=seed, relative_stderr=error, **grid)
                for seed in range(repeats)
            ]
        )
        mean = np.mean([run.brdf[0].values for run in runs], axis=0)
        stated = np.sqrt(np.sum([run.brdf_stderr[0].values ** 2 for run in runs], axis=0)) / repeats
        scatter = np.std([run.brdf[0].values for run in runs], axis=0, ddof=1)
        stated_once = np.sqrt(np.mean([run.brdf_stderr[0].values ** 2 for run in runs], axis=0))
        low = polar <= MAX_POLAR_DEG
        significant = binned.brdf[0].values > 5.0 * binned.brdf_stderr[0].values
        z = (mean - binned.brdf[0].values) / np.hypot(stated, binned.brdf_stderr[0].values)
        z = z[low][significant[low]]
        yield {
            "case": name, "bins_s": bins_s, "expansion_s": run_s / repeats,
            "gain": compute_cost(binned, bins_s) / compute_cost(runs[0], run_s / repeats),
            "scatter": (scatter / stated_once)[low].mean(), "rms_z": np.sqrt((z**2).mean()),
            "smallest_brdf": min(float(run.brdf.min()) for run in runs),
        }  # fmt: skip


def local_estimation(rays: int = 2_000_000) -> Iterator[dict[str, Any]]:
    """Local (next-event) estimation compared with angular bins: variance at equal time.

    For layers with smooth boundaries, in the principal plane at the centres of 18 x 72 bins (as
    many as bins of 5 x 5 degrees), on one thread: the factor by which the variance of local
    estimation is below that of bins at equal time, its median and minimum over the plane.
    """
    for name, settings in LAYERS.items():
        scene = (splits.ParticleLayer(**settings), [550.0], INCIDENCE_DEG)
        splits.goniophotometer(*scene, rays=1000, estimator="bins", threads=1)
        binned = splits.goniophotometer(*scene, rays=rays, estimator="bins", threads=1)
        plane = {"polar_deg": binned.polar_deg.values, "azimuth_deg": [0.0, 180.0]}
        splits.goniophotometer(*scene, rays=1000, estimator="next_event", threads=1, **plane)
        estimate = splits.goniophotometer(
            *scene, rays=rays // 20, estimator="next_event", threads=1, seed=2, **plane
        )
        binned = binned.sel(azimuth_deg=[0.0, 180.0])
        times = [float(ds.attrs["wall_time_s"]) for ds in (binned, estimate)]
        gain = binned.brdf_stderr**2 * times[0] / (estimate.brdf_stderr**2 * times[1])
        z = (binned.brdf - estimate.brdf) / np.hypot(binned.brdf_stderr, estimate.brdf_stderr)
        yield {
            "layer": name, "bins_s": times[0], "local_estimation_s": times[1],
            "median_gain": float(gain.median()), "smallest_gain": float(gain.min()),
            "rms_z": float(np.sqrt((z**2).mean())),
        }  # fmt: skip


def forward_peaks(rays_factor: float = 1.0, seeds: int = 24) -> Iterator[dict[str, Any]]:
    """Local (next-event) estimation for peaked phase functions, with and without a separate peak.

    For non-absorbing layers with light from the zenith, on one thread, by direction of view:
    median and scatter relative to the mean with a separate peak, rms z about that mean, processor
    time per ray, and the factor by which the variance at equal time is lower with a separate peak.
    """
    for name, (phase, thickness, rays) in PEAKED_LAYERS.items():
        layer = splits.ParticleLayer(
            optical_thickness=thickness, single_scattering_albedo=1.0, refractive_index=1.0,
            ground=None, **(phase or {"phase_function": make_cloud_phase_function()}),
        )  # fmt: skip
        results = []
        for threshold in (math.inf, 20.0):
            phase_function.PEAK_THRESHOLD_PER_SR = threshold
            results.append(measure_layer(layer, round(rays_factor * rays), seeds))
        mean = results[1][0].mean(axis=0)
        costs = [value.var(axis=0) * time_s for value, _, time_s in results]
        for label, (value, stderr, time_s), cost in zip(
            ("not separate", "separate"), results, costs, strict=True
        ):
            z = np.sqrt((((value - mean) / stderr) ** 2).mean(axis=0))
            for side, quantity in enumerate(("BRDF", "BTDF")):
                for i, angle in enumerate(POLAR_DEG):
                    yield {
                        "case": name, "peak": label, "quantity": quantity, "polar_deg": angle,
                        "us_per_ray": 1e6 * time_s,
                        "median": np.median(value, axis=0)[side, i] / mean[side, i],
                        "scatter": value.std(axis=0)[side, i] / mean[side, i],
                        "rms_z": z[side, i], "gain": (costs[0] / cost)[side, i],
                    }  # fmt: skip


def reciprocity(error: float = 0.012) -> Iterator[dict[str, Any]]:
    """Helmholtz reciprocity of dense media: f(i → r) against f(r → i), by interpretation.

    For each medium and interpretation, the relative difference of pairs of directions (incidence,
    view, azimuth) and its standard error, in per cent.  Dilute grains are reciprocal
    (tests/physics).  Dense ones are not if a grain that overlaps is rejected, and nearly so if it
    is skipped.
    """
    angles = sorted({angle for pair in ANGLE_PAIRS for angle in pair[:2]})
    azimuths = sorted({float(pair[2]) for pair in ANGLE_PAIRS})
    for name, (kind, settings, wavelength) in DENSE_MEDIA.items():
        for label, interpretation in INTERPRETATIONS.items():
            medium = kind(**settings, interpretation={"set": "splits_2007", **interpretation})
            runs = {
                angle: splits.goniophotometer(
                    medium, [wavelength], angle, seed=angle, relative_stderr=error,
                    polar_deg=angles, azimuth_deg=azimuths,
                )
                for angle in angles
            }  # fmt: skip
            row: dict[str, Any] = {"medium": name, "interpretation": label}
            for incidence, view, azimuth in ANGLE_PAIRS:
                forward = (
                    runs[incidence].sel(polar_deg=view, azimuth_deg=azimuth).isel(wavelength=0)
                )
                reverse = (
                    runs[view].sel(polar_deg=incidence, azimuth_deg=azimuth).isel(wavelength=0)
                )
                mean = 0.5 * float(forward.brdf + reverse.brdf)
                difference = float(forward.brdf - reverse.brdf) / mean
                stderr = float(np.hypot(forward.brdf_stderr, reverse.brdf_stderr)) / mean
                pair = f"{incidence}, {view}, {azimuth}"
                row[pair] = f"{100.0 * difference:+.1f} ± {100.0 * stderr:.1f}"
            yield row


RAYLEIGH = {
    "optical_thickness": 10.0, "phase_function": "rayleigh", "single_scattering_albedo": 0.99,
}  # fmt: skip
POLARIZING_MEDIA = {
    "snow, 600 nm": (splits.Snow(depth_m=0.02), 600.0),
    "sand, 650 nm": (splits.Sand(depth_m=0.005), 650.0),
    "particles": (splits.ParticleLayer(**RAYLEIGH), 600.0),
}
REPEATS = 5
EVENT_COUNTS = np.array([1, 2, 5, 10, 20, 50, 100, 150, 200, 300, 400])


def measure_bins(medium, wavelength: float, rays: int, **settings):
    """Return bins of a medium, traced on one thread."""
    return splits.goniophotometer(
        medium, [wavelength], INCIDENCE_DEG, rays=rays, estimator="bins", n_bins=(4, 8), threads=1,
        **settings,
    )  # fmt: skip


def count_segments(medium, wavelength: float, stokes: bool, rays: int = 2000) -> float:
    """Return the mean number of path segments of a ray."""
    polarization = IncidentPolarization() if stokes else None
    scene = build_scene(medium, INCIDENCE_DEG, False, polarization)
    constants = compute_optical_constants(medium, np.array([wavelength]))
    optics = make_bounding_optics(constants.indices[0], constants.absorption)
    n_stokes = 0 if scene.stokes is None else N_STOKES_COLUMNS
    exits = allocate_exits(rays, optics.n.size, n_stokes)
    work = np.array([0, 0, rays, NO_MAX_ORDER])
    return float(history.trace_rays(1, work, scene, optics, exits, None).n_segments[0]) / rays


def polarization_cost(rays: int = 40_000) -> Iterator[dict[str, Any]]:
    """Time per path segment of polarized and scalar rays, and ratios of times per ray.

    A segment ends with a collision or at a boundary.  Runs alternate on one thread.  The scalar
    kernel traces polarized rays; without polarization grains have a vectorized kernel, too.
    """
    for name, (medium, wavelength) in POLARIZING_MEDIA.items():
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
                ds = measure_bins(one, wavelength, rays, seed=repeat, **settings)
                # The first measure_bins may compile.
                if repeat > 0:
                    times[variant].append(1e9 * float(ds.attrs["wall_time_s"]) / rays)
        for variant, values in times.items():
            one, settings = variants[variant]
            segments = count_segments(one, wavelength, settings.get("stokes", False))
            low, middle, high = np.quantile(values, [0.0, 0.5, 1.0]) / segments
            ratios = np.array(times["polarized"]) / np.array(values)
            yield {
                "medium": name, "variant": variant, "segments_per_ray": segments,
                "ns_per_segment": middle, "lowest": low, "highest": high,
                "polarized_takes": np.median(ratios), "at_least": ratios.min(),
                "at_most": ratios.max(),
            }  # fmt: skip


def polarization_error(
    rays: tuple[int, ...] = (10_000, 40_000, 160_000, 640_000),
) -> Iterator[dict[str, Any]]:
    """Error of the degree of linear polarization √(Q² + U²)/I of one bin of snow against time."""
    medium, wavelength = POLARIZING_MEDIA["snow, 600 nm"]
    for count in rays:
        ds = measure_bins(medium, wavelength, count, stokes=True, seed=7).isel(
            wavelength=0, polar_deg=2, azimuth_deg=0
        )
        q, u, i = (float(ds[name]) for name in ("brdf_q", "brdf_u", "brdf"))
        degree = np.hypot(q, u) / i
        q_error, u_error, i_error = (
            float(ds[f"{name}_stderr"]) for name in ("brdf_q", "brdf_u", "brdf")
        )
        stderr = np.hypot(
            np.hypot(q * q_error, u * u_error) / np.hypot(q, u) / i, degree * i_error / i
        )
        seconds = float(ds.attrs["wall_time_s"])
        yield {
            "rays": count, "seconds": seconds, "degree_of_polarization": degree, "stderr": stderr,
            "error_times_root_of_time": stderr * seconds**0.5,
        }  # fmt: skip


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


def weights(rays: int = 400_000) -> Iterator[dict[str, Any]]:
    """Second moment of the weight of Stokes vectors on scalar paths, by number of events.

    Rays could follow scalar paths and carry the Stokes vector as a weight: the factor of a
    reflection is (R₊ + R₋ q)/R₊, that of a refraction (T₊ + T₋ q)/T₊.  The mean weight is 1.  Its
    second moment on scalar paths is its mean on polarized paths, whose probability is the weight
    times that of scalar ones.  Rays hit one smooth grain of clear ice after another.  The last
    column is the growth of the logarithm per event from 50 events on.
    """
    medium = splits.Snow(facetness=(0.0,) * 4, saturation=0.0)
    scene = build_scene(medium, 0.0, False, IncidentPolarization())
    on_scalar, on_polarized = (
        tally_weights(rays, EVENT_COUNTS, scene, 1.31, polarized) / rays
        for polarized in (False, True)
    )
    late = EVENT_COUNTS >= 50
    rate = np.polyfit(EVENT_COUNTS[late], np.log(on_polarized[0, late]), 1)[0]
    for row, count in enumerate(EVENT_COUNTS):
        second = on_polarized[0, row]
        yield {
            "events": count, "mean_weight": on_scalar[0, row],
            "square_on_scalar_paths": on_scalar[1, row], "by_polarized_paths": second,
            "rms_error_of_a_ray": max(second - 1.0, 0.0) ** 0.5, "growth_per_event": rate,
        }  # fmt: skip


WAVELENGTH_NM = 1310.0
SPHERE = (1.0, 1.0, 1.0, 0.0)
FACETED_GRAINS: dict[str, dict[str, Any]] = {
    f"spheres, facetness {value:g}": {"sphericity": SPHERE, "facetness": (value, value, value, 0.0)}
    for value in (0.0, 0.05, 0.1, 0.2)
}
FACETED_GRAINS["natural snow"] = {}


def facetness(
    rays: int = 2_000_000, max_stderr: float = 0.0005, threads: int = 2
) -> Iterator[dict[str, Any]]:
    """Effect of polarization on the asymmetry parameter and the reflectance of deep snow.

    Light that a facet reflects or transmits is polarized, and the next facet reflects it as
    polarized light.  Without `stokes`, each facet receives unpolarized light.  The table is
    docs/theory/polarization_by_facetness.csv.
    """
    for name, shape in FACETED_GRAINS.items():
        snow = splits.Snow.natural(specific_surface_area_m2_kg=20.0, **shape)
        row: dict[str, Any] = {"grains": name}
        for label, stokes in (("scalar", False), ("polarized", True)):
            grains = splits.single_scattering(
                snow, WAVELENGTH_NM, moments=2, rays=rays, threads=threads, stokes=stokes
            )
            spectrum = splits.spectrophotometer(
                snow, [WAVELENGTH_NM], "diffuse", max_stderr=max_stderr, stokes=stokes,
                threads=threads,
                solver="monte_carlo",
            )  # fmt: skip
            row |= {
                f"g_{label}": grains.asymmetry_parameter.item(),
                f"R_{label}": spectrum.reflectance.item(),
            }
            errors = grains.asymmetry_parameter_stderr, spectrum.reflectance_stderr
            row |= {f"{q}_stderr": e.item() for q, e in zip(("g", "R"), errors, strict=True)}
        row["g_change"] = row["g_polarized"] - row["g_scalar"]
        row["R_change"] = row["R_polarized"] - row["R_scalar"]
        # Both runs have the same error.
        yield {name: value for name, value in row.items() if not name.endswith("_stderr")} | {
            "g_error": math.sqrt(2.0) * row["g_stderr"], "R_error": math.sqrt(2.0) * row["R_stderr"]
        }  # fmt: skip


if __name__ == "__main__":
    run_command(
        bins, local_estimation, forward_peaks, reciprocity, polarization_cost, polarization_error,
        weights, facetness,
    )  # fmt: skip
