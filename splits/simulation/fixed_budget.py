"""A spectrum from a fixed number of rays: fast, smooth in the medium's parameters, not adaptive.

The rays, the streams of random numbers and the wavelengths at which paths are traced do not
depend on the medium.  Two media that differ a little are then met by almost the same paths, and
their difference is known far better than either spectrum: what a fit or a derivative needs
(common random numbers; Glasserman & Yao 1992, Management Science 38, 884-908).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from splits.core.validation import invalid
from splits.media.medium import Medium
from splits.simulation.arguments import (
    check_incidence,
    check_integer,
    check_medium,
    check_wavelengths,
)
from splits.simulation.runner import Runner
from splits.simulation.scene import compute_optical_constants
from splits.simulation.spectral_nodes import make_nodes
from splits.simulation.tally import N_BATCHES, PathTally, rescale_deviations

SINGLE_STRATUM = (-1.0,)
"""One level per ensemble: every wavelength listens to every ray, so that all share their noise."""


def estimate_fixed_budget(
    medium: Medium,
    wavelength_nm: Any,
    incidence_deg: float | str,
    node_rows: Sequence[int],
    rays_per_node: int,
    seed: int,
    threads: int | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimate reflectance, transmittance and absorptance with a fixed number of rays.

    Parameters
    ----------
    medium : GranularMedium
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm).
    incidence_deg : float or "diffuse"
        Polar angle of a beam, 0 to 89.9999 degrees, or equal radiance from everywhere.
    node_rows : sequence of int
        Positions of the wavelengths whose refractive indices paths are traced with: different,
        at least one.  Every wavelength takes the one or two that suit it best.
    rays_per_node : int
        At least 1; rounded up to whole batches.
    seed : int
        Non-negative.
    threads : int, optional
        Default: every CPU this process may use; the numbers do not depend on it.

    Returns
    -------
    mean, stderr : float, shape (3, wavelengths)
        Reflected, transmitted and absorbed.  The standard error is that of the random numbers;
        what interpolation between nodes misses is not in it.
    groups : float, shape (GROUPS, 2, wavelengths)
        How far groups of rays take the reflected and transmitted means off, see
        `splits.simulation.estimators.SpectralEstimate`.

    Raises
    ------
    ValueError
        For a value outside its range.
    """
    check_medium(medium)
    wavelengths = check_wavelengths(wavelength_nm)
    rows = _check_node_rows(node_rows, len(wavelengths))
    check_integer("rays_per_node", rays_per_node, 1)
    check_integer("seed", seed, 0)
    index, absorption = compute_optical_constants(medium, wavelengths)
    nodes = make_nodes(index, medium.list_interfaces(), rows)
    runner = Runner(medium, check_incidence(incidence_deg), int(seed), threads, False)
    # An ensemble keeps its number, hence its streams, also where a neighbour is not drawn on.
    ensembles = [
        PathTally(number, m, absorption, w > 0.0, runner.tracer.traits, bounds=SINGLE_STRATUM)
        for number, (m, w) in enumerate(zip(nodes.index, nodes.weights, strict=True))
        if w.any()
    ]
    weights = nodes.weights[nodes.weights.any(axis=1)]
    runner.trace([(e, level, rays_per_node) for e in ensembles for level in e.strata], 1.0, 0.0)
    mean = np.einsum(
        "jw,jqw->qw",
        weights,
        np.stack([e.expand_to_all_rows(e.compute_means()) for e in ensembles]),
    )
    variance = np.zeros((3, len(wavelengths)))
    groups = np.zeros((N_BATCHES, 2, len(wavelengths)))
    for e, w in zip(ensembles, weights, strict=True):
        part = w[e.rows]
        variance[:, e.rows] += part**2 * e.compute_variances() / np.maximum(e.n_rays, 1.0)
        groups[..., e.rows] += part * e.compute_batch_deviations()
    mean = np.concatenate([mean, 1.0 - mean.sum(axis=0, keepdims=True)])
    return mean, np.sqrt(variance), rescale_deviations(groups, variance[:2])


def choose_node_rows(n_wavelengths: int) -> tuple[int, ...]:
    """Return the first, an early and the last of so many wavelengths.

    Three nodes hold the index of iron oxides from 400 to 1000 nm, which bends in the first third,
    so well that interpolation misses at most about 0.01.
    """
    return tuple(sorted({0, round(0.3 * (n_wavelengths - 1)), n_wavelengths - 1}))


def _check_node_rows(node_rows: Sequence[int], n_wavelengths: int) -> list[int]:
    """Return the rows as a list, or refuse them."""
    rows = [int(row) for row in node_rows]
    if not rows or len(set(rows)) < len(rows) or min(rows) < 0 or max(rows) >= n_wavelengths:
        raise invalid(
            "node_rows",
            list(node_rows),
            f"different positions from 0 to {n_wavelengths - 1}, at least one",
        )
    return rows
