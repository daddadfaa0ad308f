"""How much reflectance moves and bends with refractive index: what bounds interpolation's error.

The spectral estimator interpolates linearly between index nodes and bounds what this misses by
SLOPE times the relative distance of the contrasts from the chord, and CURVATURE/2 times the mean
square of the relative distances from the nodes.  This program measures the first and the second
derivative of reflectance and transmittance by ln c from three contrasts c with absorption fixed,
for snow and sand, dry and wet, and prints them with their standard errors; for sands, what
interpolated spectra miss of spectra traced at every wavelength; and, for snow of Table 1, what few
nodes miss of many at 211 wavelengths.

    python benchmarks/interpolation.py
"""

from __future__ import annotations

import numpy as np

import splits
from splits.materials.lookup import absorption_coefficient
from splits.simulation.fixed_budget import estimate_fixed_budget
from splits.simulation.interpolation_bounds import MAX_LOG_CURVATURE, MAX_LOG_SLOPE
from splits.simulation.runner import Runner
from splits.simulation.spectral_nodes import choose_nodes
from splits.simulation.tally import PathTally

# Wider apart than any spectrum spreads them, so that the bend shows beyond the noise.
SOLIDS = {
    "snow, dry": (0.0, (1.42, 1.31, 1.233), (1.0, 1.0, 1.0)),
    "snow, S = 0.05": (0.05, (1.42, 1.31, 1.233), (1.44, 1.33, 1.253)),
    "snow, S = 0.3": (0.3, (1.42, 1.31, 1.233), (1.44, 1.33, 1.253)),
    "snow, water-filled": (1.0, (1.3, 1.3, 1.3), (1.3195, 1.326, 1.3351)),
    "sand, dry": (0.0, (2.0, 1.7, 1.49), (1.0, 1.0, 1.0)),
    "sand, water-filled": (1.0, (1.65, 1.55, 1.48), (1.33, 1.33, 1.33)),
}
MANY_NODES_RAYS = 3e-5
"""Interpolation error allowed where many nodes stand for the truth."""
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
    # The parabola through three points, by Lagrange.
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


def print_interpolation_errors() -> None:
    """Print what interpolated reflectance of sands misses of that traced at every wavelength."""
    wavelengths = np.arange(400.0, 1001.0, 50.0)
    for name, sand in SANDS.items():
        index = sand.compute_refractive_indices(wavelengths)
        nodes = choose_nodes(index, sand.list_interfaces(), TOLERANCE)
        rows = [int(np.flatnonzero((index == node).all(axis=1))[0]) for node in nodes.index]
        few, few_error, _ = estimate_fixed_budget(sand, wavelengths, 0.0, rows, RAYS, 1)
        every, error, _ = estimate_fixed_budget(
            sand, wavelengths, 0.0, range(len(wavelengths)), RAYS, 2
        )
        off, noise = few[0] - every[0], np.hypot(few_error[0], error[0])
        between = np.setdiff1d(np.arange(len(wavelengths)), rows)
        z = off[between] / noise[between]
        print(
            f"{name}, {len(rows)} nodes for {len(wavelengths)} wavelengths: largest miss between "
            f"nodes {np.abs(off[between]).max(initial=0.0):.4f} ± {noise.max():.4f}, mean "
            f"{off[between].mean():+.4f}, rms z {np.sqrt(np.mean(z**2)):.2f}, largest bound "
            f"{nodes.interpolation_bound.max():.4f}",
            flush=True,
        )


def print_bias() -> None:
    """Compare interpolation as a spectrum of error 0.001 does it with many nodes, for snow.

    Both take their nodes' values from the same paths, so that most of the noise cancels, and
    every wavelength is held against the error that such a dataset states.
    """
    snow, wavelengths = splits.Snow(), np.arange(400.0, 2501.0, 10.0)
    stated = splits.spectrophotometer(snow, wavelengths, max_stderr=0.001, seed=9)
    index = snow.compute_refractive_indices(wavelengths)
    few = choose_nodes(index, snow.list_interfaces(), 0.4 * 0.001)
    many = choose_nodes(index, snow.list_interfaces(), MANY_NODES_RAYS)
    rows = {tuple(node): i for i, node in enumerate(many.index)}
    extra = [node for node in few.index if tuple(node) not in rows]
    every = np.concatenate([many.index, np.array(extra).reshape(-1, index.shape[1])])
    rows = {tuple(node): i for i, node in enumerate(every)}
    weights = np.zeros((2, len(every), len(wavelengths)))
    for row, nodes in enumerate((few, many)):
        for node, weight in zip(nodes.index, nodes.weights, strict=True):
            weights[row, rows[tuple(node)]] += weight
    off = []
    for seed in range(SEEDS):
        runner = Runner(snow, 0.0, seed, None, False)
        absorption = absorption_coefficient(index, wavelengths[:, np.newaxis])
        # One number for all: the same random streams at every node.
        ensembles = [
            PathTally(0, node, absorption, w > 0.0, runner.tracer.traits)
            for node, w in zip(every, weights.max(axis=0), strict=True)
        ]
        runner.trace([(e, level, BIAS_RAYS) for e in ensembles for level in e.strata], 1.0, 0.0)
        means = np.stack([e.compute_means() for e in ensembles])
        off.append(np.einsum("jw,jqw->qw", weights[0] - weights[1], means))
    miss = np.mean(off, axis=0)
    noise = np.std(off, axis=0, ddof=1) / np.sqrt(SEEDS)
    error = np.stack([stated.reflectance_stderr, stated.transmittance_stderr])
    share = np.abs(miss) / error
    print(
        f"Table 1, {len(few.index)} nodes against {len(many.index)} (bound {MANY_NODES_RAYS:g}), "
        f"{len(wavelengths)} wavelengths: reflectance off by rms "
        f"{np.sqrt(np.mean(miss[0] ** 2)):.1e}, "
        f"at most {np.abs(miss[0]).max():.1e} (noise up to {noise[0].max():.1e}); "
        f"at most {share[0].max():.2f} of the error stated, {(share[0] > 1.0).sum()} wavelengths "
        f"beyond it; transmittance at most {np.abs(miss[1]).max():.1e}",
        flush=True,
    )


def main() -> None:
    """Print all three comparisons."""
    print_bias()
    print_interpolation_errors()
    for name, (saturation, solids, waters) in SOLIDS.items():
        kind = name[:4]
        pore = np.array(waters) if saturation == 1.0 else np.ones(3)
        x = np.log(np.abs(np.array(solids) / pore - 1.0))
        for k in ABSORPTION[kind]:
            mediums = [
                make_medium(kind, saturation, complex(solid, k), complex(water, k))
                for solid, water in zip(solids, waters, strict=True)
            ]
            slope, slope_error, bend, bend_error = compute_derivatives(mediums, x)
            print(
                f"{name}, k {k:g}: slope R {slope[0]:+.2f} ± {slope_error[0]:.2f}, "
                f"T {slope[1]:+.2f} ± {slope_error[1]:.2f} (bound {MAX_LOG_SLOPE:g}); "
                f"bend R {bend[0]:+.2f} ± {bend_error[0]:.2f}, "
                f"T {bend[1]:+.2f} ± {bend_error[1]:.2f} (bound {MAX_LOG_CURVATURE:g})",
                flush=True,
            )


if __name__ == "__main__":
    main()
