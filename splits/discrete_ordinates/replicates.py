"""Replicates of layers with traced grains, each without one batch of rays, and their scatter."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from splits.core.uncertainty import compute_jackknife_stderr
from splits.discrete_ordinates.granular_layers import GranularLayer
from splits.discrete_ordinates.traced_grains import TracedGrains
from splits.kernels.grains.single_grain import N_SCATTERING_BATCHES


def list_traced(layers: Sequence[GranularLayer]) -> list[str]:
    """Return the digests of the traced grains of layers."""
    sources = (layer.grains for layer in layers)
    return sorted({grains.digest for grains in sources if isinstance(grains, TracedGrains)})


def iterate_replicates(
    layers: Sequence[GranularLayer], digest: str
) -> Iterator[list[GranularLayer]]:
    """Yield the layers with each replicate of the traced grains of a digest."""
    for number in range(1, 1 + N_SCATTERING_BATCHES):
        yield [layer.use_replicate(digest, number) for layer in layers]


def compute_replicate_error(
    layers: Sequence[GranularLayer], solve: Callable[[list[GranularLayer]], np.ndarray]
) -> np.ndarray:
    """Return the error of a result due to the paths through single grains (jackknife).

    Those through the grains of different layers are independent.

    Parameters
    ----------
    layers : sequence of GranularLayer
        With traced grains.
    solve : callable
        Returns the result for layers.
    """
    variance: Any = 0.0
    for digest in list_traced(layers):
        results = np.array([solve(one) for one in iterate_replicates(layers, digest)])
        variance = variance + compute_jackknife_stderr(results) ** 2
    error: np.ndarray = np.sqrt(variance)
    return error
