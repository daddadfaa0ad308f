"""Interface to the kernels: tracers of scenes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from splits.kernels.compiler.features import Features
from splits.simulation.tally import Stratum, TransportTraits


class TraceResult(NamedTuple):
    """Result of tracing work items, besides the exits.

    Attributes
    ----------
    n_segments : int, shape (items,)
    crossings : list of float, shape (crossings, columns)
        Boundary crossings of each item, ray by ray, rays counted from its first; see
        `splits.kernels.tallies.crossings`.
    lost : str
        Why a ray was lost, or an empty string.
    """

    n_segments: np.ndarray
    crossings: list[np.ndarray]
    lost: str


class Tracer(Protocol):
    """Interface to the kernel of a scene.

    Attributes
    ----------
    traits : TransportTraits
    normal_incidence : bool
        Whether the beam is along the normal, so that the scene is axisymmetric.
    diffuse : bool
        Whether the incident light is diffuse.
    boundary_depths_m : float, shape (boundaries,)
        Depths (m) of all boundaries of the scene; of a rough top, a height above it.
    stokes_columns : tuple of int
        Columns of exits that hold Q, U, V over I, or nothing.
    """

    traits: TransportTraits
    normal_incidence: bool
    diffuse: bool
    boundary_depths_m: np.ndarray
    stokes_columns: tuple[int, ...]

    def get_features(self, stratum: Stratum) -> Features | None:
        """Return the vectorized kernel's features for a stratum, or None for a scalar kernel."""
        ...

    def share_kernel(self, strata: Sequence[Stratum]) -> None:
        """Let strata use one kernel, if possible."""
        ...

    def allocate_exits(self, n_rays: int) -> np.ndarray:
        """Return an array for the exits of `n_rays` rays."""
        ...

    def trace(self, work: np.ndarray, strata: Sequence[Stratum], exits: np.ndarray) -> TraceResult:
        """Trace items of strata that share features.

        Parameters
        ----------
        work : int64, shape (items, 4)
            See `splits.kernels.transport.history.trace_batch`.
        strata : sequence of Stratum
            One for each item.
        exits : float, shape (rays, columns)
            Of all items together.

        Returns
        -------
        TraceResult
        """
        ...
