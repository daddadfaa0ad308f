"""Spectra of a table by discrete ordinates: all angles of incidence of a medium in one solution."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splits.discrete_ordinates.applicability import make_granular_stack
from splits.discrete_ordinates.granular_stack import GranularStack, SpectrumSolution
from splits.discrete_ordinates.transmittance_error import solve_with_exponent_error
from splits.instruments.solver import make_estimate
from splits.media.medium import Medium
from splits.simulation.spectral_tally import SpectralEstimate
from splits.simulation.threads import DaemonThreadPool, limit_blas_threads
from splits.tables.plan import PathGroup


class SolutionCache:
    """Cache of the solutions of media for all incidences of a table; the last media are kept."""

    def __init__(self) -> None:
        self._last: _Solutions | None = None

    def get(
        self, group: PathGroup, wavelength_nm: np.ndarray, max_stderr: float, threads: int
    ) -> SpectralEstimate:
        """Return the spectra of a group; its media are solved for all incidences at once.

        Parameters
        ----------
        group : PathGroup
        wavelength_nm : float, shape (wavelengths,)
        max_stderr : float
            Determines the number of streams.
        threads : int
        """
        last = self._last
        if last is None or last.group.path_sharing is not group.path_sharing:
            angles = [float(one) for one in group.incidences if one != "diffuse"]
            cosines = np.cos(np.radians(angles))
            media = group.path_sharing.media
            solutions = _solve_media(media, wavelength_nm, cosines, max_stderr, threads)
            last = self._last = _Solutions(group, angles, solutions)
        is_diffuse = group.incidence == "diffuse"
        column = -1 if is_diffuse else last.angles.index(float(group.incidence))
        return make_estimate(last.solutions, column)


class _Solutions(NamedTuple):
    """Solutions of the media of a group for angles of incidence (degrees)."""

    group: PathGroup
    angles: list[float]
    solutions: list[SpectrumSolution]


def _solve_media(
    media: Sequence[Medium], wavelength_nm: np.ndarray, cosines: np.ndarray, max_stderr: float,
    threads: int,
) -> list[SpectrumSolution]:  # fmt: skip
    # Paths through grains use all threads themselves.
    stacks = [make_granular_stack(medium, wavelength_nm, max_stderr, threads) for medium in media]

    def solve(stack: GranularStack) -> SpectrumSolution:
        return solve_with_exponent_error(stack, cosines, max_stderr)

    with limit_blas_threads(), DaemonThreadPool(threads) as pool:
        return list(pool.map(solve, stacks))
