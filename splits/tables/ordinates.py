"""Spectra of a table by discrete ordinates: all angles of incidence of a medium in one solution."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splits.discrete_ordinates.applicability import make_granular_stack
from splits.discrete_ordinates.granular_stack import (
    GranularStack,
    SpectrumSolution,
    solve_with_exponent_error,
)
from splits.instruments.solver import make_estimate
from splits.instruments.spectrophotometer import SpectralRequest
from splits.media.medium import Medium
from splits.simulation.spectral_tally import SpectralEstimate
from splits.simulation.threads import DaemonThreadPool, limit_blas_threads
from splits.tables.media_cache import MediaCache
from splits.tables.plan import DIFFUSE, PathGroup


def solve_group(group: PathGroup, request: SpectralRequest, cache: MediaCache) -> SpectralEstimate:
    """Return the spectra of a group; its media are solved for all incidences at once.

    The error of the request determines the number of streams.
    """
    angles = [float(incidence) for incidence in group.incidences if incidence != DIFFUSE]
    solutions = cache.get(
        group.path_sharing, lambda: _solve_media(group.path_sharing.media, angles, request)
    )
    is_diffuse = group.incidence == DIFFUSE
    return make_estimate(solutions, -1 if is_diffuse else angles.index(float(group.incidence)))


def _solve_media(
    media: Sequence[Medium], incidence_deg: list[float], request: SpectralRequest
) -> list[SpectrumSolution]:
    """Return the solution of each medium, for all angles of incidence."""
    cosines, max_stderr = np.cos(np.radians(incidence_deg)), request.max_stderr
    threads = request.run.threads
    # Paths through grains use all threads themselves.
    stacks = [
        make_granular_stack(medium, request.wavelengths, max_stderr, threads) for medium in media
    ]

    def solve(stack: GranularStack) -> SpectrumSolution:
        return solve_with_exponent_error(stack, cosines, max_stderr)

    with limit_blas_threads(), DaemonThreadPool(threads) as pool:
        return list(pool.map(solve, stacks))
