"""Forward model of sand: simulated reflectance and its Jacobian over the fitted parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from splits.core.validation import invalid
from splits.retrieval.sand_parameters import UnitCube
from splits.simulation.spectral_tally import choose_node_rows, estimate_fixed_budget


@dataclass(frozen=True)
class Effort:
    """Computational effort of a fit.

    Attributes
    ----------
    points : int
        Number of sands in the survey, a power of 2.
    starts : tuple of int
        Number of the best sands from which each stage of descents starts.
    evaluations : tuple of int
        Largest number of simulations per descent, by stage.
    rays : tuple of int
        Rays per node of the survey and of every stage.
    max_stderr : float
        Standard error of the final spectrum, 1e-6 to 0.5.
    """

    points: int = 128
    starts: tuple[int, ...] = (6, 3, 1)
    evaluations: tuple[int, ...] = (40, 40, 40)
    rays: tuple[int, ...] = (512, 512, 2048, 16_384)
    max_stderr: float = 0.002

    def __post_init__(self) -> None:
        if not len(self.starts) == len(self.evaluations) == len(self.rays) - 1:
            raise invalid("effort", self, "starts, evaluations and rays for the same stages")


class SandForwardModel:
    """Forward model of sands with a fixed number of rays, see `splits.retrieval.gauss_newton`.

    Parameters
    ----------
    cube : UnitCube
    wavelengths : float, shape (wavelengths,)
        Wavelengths (nm).
    incidence : float or "diffuse"
    effort : Effort
    seed : int
    threads : int, optional

    Attributes
    ----------
    n_simulations : int
        Number of sands simulated so far.
    """

    bound_margin = 0.0

    def __init__(
        self,
        cube: UnitCube,
        wavelengths: np.ndarray,
        incidence: float | str,
        effort: Effort,
        seed: int,
        threads: int | None,
    ) -> None:
        self.cube, self.state_vector = cube, cube.state_vector
        self.wavelengths_nm, self.incidence, self.threads = wavelengths, incidence, threads
        self.n_rays = effort.rays
        self.n_simulations = 0
        n_seeds = len(effort.rays) + N_JACOBIANS + 1
        states = np.random.SeedSequence(seed).generate_state(n_seeds)
        self.seeds = [int(state) for state in states]
        """Seeds of the survey and every stage, of the Jacobians, and of the final spectrum."""
        self._last_result: tuple[bytes, int, np.ndarray] = (b"", 0, np.empty(0))

    def _simulate(self, state: np.ndarray, rays: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Return reflectance and its batch deviations."""
        self.n_simulations += 1
        mean, _, batches = estimate_fixed_budget(
            self.cube.to_sand(state), self.wavelengths_nm, self.incidence,
            choose_node_rows(len(self.wavelengths_nm)), rays, seed, self.threads,
        )  # fmt: skip
        return mean[0], batches[:, 0]

    def evaluate(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return reflectance with the rays of a stage, shape (wavelengths,)."""
        if self._last_result[:2] != (state.tobytes(), stage):
            reflectance = self._simulate(state, self.n_rays[stage], self.seeds[stage])[0]
            self._last_result = state.tobytes(), stage, reflectance
        return self._last_result[2]

    def compute_jacobian(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return the Jacobian by one-sided differences inside the cube."""
        reflectance, columns = self.evaluate(state, stage), []
        for i, coordinate in enumerate(state):
            shifted = state.copy()
            shifted[i] += JACOBIAN_STEP if coordinate + JACOBIAN_STEP <= 1.0 else -JACOBIAN_STEP
            columns.append(
                (self.evaluate(shifted, stage) - reflectance) / (shifted[i] - coordinate)
            )
        return np.column_stack(columns)

    def noise(self, state: np.ndarray) -> np.ndarray:
        """Return the covariance of the noise common to all simulations of the last stage."""
        batches = self._simulate(state, self.n_rays[-1], self.seeds[len(self.n_rays) - 1])[1]
        covariance: np.ndarray = batches.T @ batches
        return covariance

    def compute_jacobians(self, state: np.ndarray) -> list[np.ndarray]:
        """Return independent Jacobians, each with its own random numbers."""
        first = len(self.n_rays)
        rays = max(self.n_rays[-1] // _JACOBIAN_RAYS_DIVISOR, 1)
        return [
            compute_central_differences(partial(self._simulate_reflectance, rays, stream), state)
            for stream in self.seeds[first : first + N_JACOBIANS]
        ]

    def _simulate_reflectance(self, rays: int, seed: int, state: np.ndarray) -> np.ndarray:
        return self._simulate(state, rays, seed)[0]


def compute_central_differences(
    model: Callable[[np.ndarray], np.ndarray], x: np.ndarray
) -> np.ndarray:
    """Return the Jacobian by central differences, clipped to the cube."""
    columns = []
    for i in range(len(x)):
        upper, lower = x.copy(), x.copy()
        upper[i] = min(x[i] + 2.0 * JACOBIAN_STEP, 1.0)
        lower[i] = max(x[i] - 2.0 * JACOBIAN_STEP, 0.0)
        columns.append((model(upper) - model(lower)) / (upper[i] - lower[i]))
    return np.column_stack(columns)


JACOBIAN_STEP = 0.05
"""Step of a coordinate for derivatives, large enough compared with uncorrelated noise."""
N_JACOBIANS = 4
"""Number of independent Jacobians for the errors."""
_JACOBIAN_RAYS_DIVISOR = 8
"""Ratio of the rays of the last stage to those of a Jacobian, whose noise causes no bias."""
