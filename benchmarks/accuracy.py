"""Stated errors of spectra: the stopping rule, and the interpolation between refractive indices.

The spectral estimator interpolates linearly between index nodes.  Its error bound is MAX_LOG_SLOPE
times the relative distance of the contrasts from the chord, and MAX_LOG_CURVATURE/2 times the mean
square of the relative distances from the nodes.

    python benchmarks/accuracy.py {stopping,node_bias,sands,derivatives} [--table TABLE.csv]
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from command import run_command

import splits
from splits.simulation.engine import simulate
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import build_scene
from splits.simulation.shared_paths import PathSharingMedia, SpectralRows
from splits.simulation.spectral_nodes import (
    MAX_LOG_CURVATURE,
    MAX_LOG_SLOPE,
    IndexNodes,
    choose_nodes,
    make_separate_nodes,
)
from splits.simulation.spectral_tally import SINGLE_STRATUM, SpectralEstimate, SpectralTally
from splits.simulation.strata import STRATUM_BOUNDS, StoppingRule

WAVELENGTHS_NM = np.arange(400, 2501, 10)
SENSOR_BANDS = {
    "400-800 nm": (400, 800),
    "900-1400 nm": (900, 1400),
    "1450-1600 nm": (1450, 1600),
    "1950-2100 nm": (1950, 2100),
    "2400-2500 nm": (2400, 2500),
}


# Wider apart than in any spectrum, so that the curvature is larger than the noise.
MATERIALS = {
    "snow, dry": (0.0, (1.42, 1.31, 1.233), (1.0, 1.0, 1.0)),
    "snow, S = 0.05": (0.05, (1.42, 1.31, 1.233), (1.44, 1.33, 1.253)),
    "snow, S = 0.3": (0.3, (1.42, 1.31, 1.233), (1.44, 1.33, 1.253)),
    "snow, water-filled": (1.0, (1.3, 1.3, 1.3), (1.3195, 1.326, 1.3351)),
    "sand, dry": (0.0, (2.0, 1.7, 1.49), (1.0, 1.0, 1.0)),
    "sand, water-filled": (1.0, (1.65, 1.55, 1.48), (1.33, 1.33, 1.33)),
}
REFERENCE_TOLERANCE = 3e-5
"""Interpolation error of the reference with many nodes."""
SEEDS = 8
BIAS_RAYS = 100_000
ABSORPTION = {"snow": (1e-9, 1e-6, 1e-5), "sand": (1e-6, 1e-5, 1e-3)}


def make_medium(kind: str, saturation: float, solid: complex, water: complex) -> object:
    """Return a medium of one mineral and given indices."""
    if kind == "snow":
        index = {"ice": solid, "water": water}
        return splits.Snow(saturation=saturation, depth_m=0.03, refractive_index=index)
    index = {"quartz": solid, "water": water}
    return splits.Sand(
        iron_oxide=0.0, partition=(1.0, 0.0, 0.0), saturation=saturation, depth_m=0.01,
        refractive_index=index,
    )  # fmt: skip


def compute_derivatives(mediums: list[object], x: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return first and second derivative of R and T by x at the middle point, with errors."""
    values, errors = [], []
    for seed, medium in enumerate(mediums):
        ds = splits.spectrophotometer(medium, [1000], max_stderr=0.002, seed=seed)
        values.append([float(ds.reflectance[0]), float(ds.transmittance[0])])
        errors.append([float(ds.reflectance_stderr[0]), float(ds.transmittance_stderr[0])])
    # Derivatives of the Lagrange parabola through three points.
    d = np.array([(x[i] - x[i - 1]) * (x[i] - x[i - 2]) for i in range(3)])
    other = np.array([2 * x[1] - x[i - 1] - x[i - 2] for i in range(3)])
    first, second = (other / d)[:, np.newaxis], (2.0 / d)[:, np.newaxis]
    return tuple(
        part
        for factor in (first, second)
        for part in (
            (factor * values).sum(axis=0),
            np.sqrt(((factor * np.array(errors)) ** 2).sum(axis=0)),
        )
    )


SANDS = {
    "TEC 19au9815": splits.Sand(iron_oxide=0.05, partition=(0.5, 0.0, 0.5)),
    "all coated": splits.Sand(iron_oxide=0.05, partition=(0.0, 0.0, 1.0)),
    "TEC 13j9823": splits.Sand(hematite_ratio=0.498, magnetite=0.17, partition=(0.0, 1.0, 0.0)),
    "quartz, 1 % magnetite": splits.Sand(iron_oxide=0.0, magnetite=0.01, partition=(1.0, 0.0, 0.0)),
}
TOLERANCE = 0.0008
RAYS = 40_000


def trace(
    sand: splits.Sand, wavelengths: np.ndarray, nodes: IndexNodes, seed: int
) -> SpectralEstimate:
    """Return an estimate from the rays of some nodes, with statistical errors only."""
    rows = SpectralRows.from_media(PathSharingMedia.from_media([sand]), wavelengths)
    scene = build_scene(sand, 0.0, False)
    nodes = replace(nodes, interpolation_bound=np.zeros(wavelengths.size))
    tally = SpectralTally(rows, nodes, scene, SINGLE_STRATUM)
    stop = StoppingRule(0.0, RAYS * len(tally.strata), fixed=True)
    estimate: SpectralEstimate = simulate(scene, tally, stop, RunOptions.start(seed)).estimate
    return estimate


def sands() -> Iterator[dict[str, Any]]:
    """Deviations of interpolated reflectances of sands from those traced at every wavelength."""
    wavelengths = np.arange(400.0, 1001.0, 50.0)
    for name, sand in SANDS.items():
        index = sand.compute_refractive_indices(wavelengths)
        nodes = choose_nodes(index, sand.list_interfaces(), TOLERANCE)
        rows = [int(np.flatnonzero((index == node).all(axis=1))[0]) for node in nodes.index]
        few = trace(sand, wavelengths, nodes, 1)
        traced = trace(sand, wavelengths, make_separate_nodes(index), 2)
        deviation = few.mean[0] - traced.mean[0]
        noise = np.hypot(few.stderr[0], traced.stderr[0])
        off_nodes = np.setdiff1d(np.arange(len(wavelengths)), rows)
        z = deviation[off_nodes] / noise[off_nodes]
        yield {
            "sand": name, "nodes": len(rows), "wavelengths": len(wavelengths),
            "largest_deviation": np.abs(deviation[off_nodes]).max(initial=0.0),
            "noise": noise.max(), "mean_deviation": deviation[off_nodes].mean(),
            "rms_z": np.sqrt(np.mean(z**2)), "largest_bound": nodes.interpolation_bound.max(),
        }  # fmt: skip


def node_bias() -> Iterator[dict[str, Any]]:
    """Deviation of the nodes of a spectrum of error 0.001 from many nodes, for snow of Table 1.

    Both use the same paths, so that most of the noise cancels.  Deviations are compared with the
    stated error at every wavelength.
    """
    snow, wavelengths = splits.Snow(), np.arange(400.0, 2501.0, 10.0)
    stated = splits.spectrophotometer(snow, wavelengths, max_stderr=0.001, seed=9)
    index = snow.compute_refractive_indices(wavelengths)
    few = choose_nodes(index, snow.list_interfaces(), 0.4 * 0.001)
    many = choose_nodes(index, snow.list_interfaces(), REFERENCE_TOLERANCE)
    rows = {tuple(node): i for i, node in enumerate(many.index)}
    extra = [node for node in few.index if tuple(node) not in rows]
    all_nodes = np.concatenate([many.index, np.array(extra).reshape(-1, index.shape[1])])
    rows = {tuple(node): i for i, node in enumerate(all_nodes)}
    weights = np.zeros((2, len(all_nodes), len(wavelengths)))
    for row, nodes in enumerate((few, many)):
        for node, weight in zip(nodes.index, nodes.weights, strict=True):
            weights[row, rows[tuple(node)]] += weight
    spectral_rows = SpectralRows.from_media(PathSharingMedia.from_media([snow]), wavelengths)
    used = IndexNodes(all_nodes, weights.max(axis=0), np.zeros(len(wavelengths)))
    scene = build_scene(snow, 0.0, False)
    deviations = []
    for seed in range(SEEDS):
        tally = SpectralTally(spectral_rows, used, scene)
        for stratum in tally.strata:
            # The same random streams at all nodes.
            stratum.stream %= len(STRATUM_BOUNDS)
        stop = StoppingRule(0.0, BIAS_RAYS * len(tally.strata), fixed=True)
        simulate(scene, tally, stop, RunOptions.start(seed, None))
        means = tally.moments[:2, 0] / tally.count_rays()
        means *= (weights[0] - weights[1])[tally.node_of_row, tally.rows]
        deviations.append([np.bincount(tally.rows, mean, len(wavelengths)) for mean in means])
    mean_deviation = np.mean(deviations, axis=0)
    noise = np.std(deviations, axis=0, ddof=1) / np.sqrt(SEEDS)
    error = np.stack([stated.reflectance_stderr, stated.transmittance_stderr])
    ratio = np.abs(mean_deviation) / error
    for row, name in enumerate(("reflectance", "transmittance")):
        yield {
            "quantity": name, "nodes": len(few.index), "many_nodes": len(many.index),
            "rms_deviation": np.sqrt(np.mean(mean_deviation[row] ** 2)),
            "largest_deviation": np.abs(mean_deviation[row]).max(), "noise": noise[row].max(),
            "largest_of_stated": ratio[row].max(), "wavelengths_above": (ratio[row] > 1.0).sum(),
        }  # fmt: skip


def stopping(seeds: int = 200, max_stderr: float = 0.003) -> Iterator[dict[str, Any]]:
    """Bias of the stopping rule: runs stop on their own estimated error, which biases low values.

    Snow of SPLITSnow Table 1 at 211 wavelengths, many seeds at one error, compared with a reference
    of a fifth of that error.  By band, in units of stated errors: the mean deviation over seeds
    with its standard error, and the scatter between seeds.
    """
    snow = splits.Snow()

    def simulate_spectrum(error: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
        spectrum = splits.spectrophotometer(snow, WAVELENGTHS_NM, max_stderr=error, seed=seed)
        return spectrum.reflectance.values, spectrum.reflectance_stderr.values

    reference, reference_error = simulate_spectrum(0.2 * max_stderr, 1_000_000)
    runs = [simulate_spectrum(max_stderr, seed) for seed in range(seeds)]
    values, errors = (np.stack([one[row] for one in runs]) for row in (0, 1))
    stated = np.sqrt((errors**2).mean(axis=0))
    bias = (values.mean(axis=0) - reference) / stated
    noise = np.hypot(values.std(axis=0) / np.sqrt(seeds), reference_error) / stated
    scatter = values.std(axis=0, ddof=1) / stated
    for band, (low, high) in SENSOR_BANDS.items():
        inside = (low <= WAVELENGTHS_NM) & (high >= WAVELENGTHS_NM)
        yield {
            "band": band, "reflectance": reference[inside].mean(), "bias": bias[inside].mean(),
            "bias_stderr": noise[inside].mean(), "largest_bias": np.abs(bias[inside]).max(),
            "scatter": scatter[inside].mean(), "largest_scatter": scatter[inside].max(),
        }  # fmt: skip


def derivatives() -> Iterator[dict[str, Any]]:
    """First and second derivative of R and T by ln c, with errors, and their bounds.

    From three contrasts c at fixed absorption k, for dry and wet snow and sand.
    """
    for name, (saturation, solids, waters) in MATERIALS.items():
        kind = name[:4]
        pore = np.array(waters) if saturation == 1.0 else np.ones(3)
        x = np.log(np.abs(np.array(solids) / pore - 1.0))
        for k in ABSORPTION[kind]:
            mediums = [
                make_medium(kind, saturation, complex(solid, k), complex(water, k))
                for solid, water in zip(solids, waters, strict=True)
            ]
            row: dict[str, Any] = {"material": name, "k": k}
            names = ("slope", "slope_stderr", "curvature", "curvature_stderr")
            for label, values in zip(names, compute_derivatives(mediums, x), strict=True):
                row |= {f"{label}_R": values[0], f"{label}_T": values[1]}
            yield row | {"slope_bound": MAX_LOG_SLOPE, "curvature_bound": MAX_LOG_CURVATURE}


if __name__ == "__main__":
    run_command(stopping, node_bias, sands, derivatives)
