"""Forward model of retrievals by discrete ordinates: spectra of a medium without noise."""

from __future__ import annotations

from collections import defaultdict
from contextlib import suppress
from itertools import product
from typing import Any

import numpy as np

from splits.core.validation import InvalidValue
from splits.discrete_ordinates.applicability import make_granular_stack
from splits.discrete_ordinates.granular_stack import (
    choose_trial_wavelengths,
    compute_optics_error,
    solve_spectrum,
)
from splits.instruments.solver import DISCRETE_ORDINATES
from splits.media.medium import Medium
from splits.media.parameters import INCIDENCE_KEY
from splits.retrieval.forward_model import ERROR_CORRELATION_NM
from splits.retrieval.medium_model import DESCENT_STAGES, LAST_STAGE, MediumForwardModel
from splits.simulation.threads import limit_blas_threads

MAX_ERROR = 1e-3
"""Error that determines the number of streams, by default."""
DIFFERENCE_STEP = 1e-4
"""Step of coordinates for differences, whose relative error is about half of this."""


class OrdinatesForwardModel(MediumForwardModel):
    """Forward model by discrete ordinates.

    All stages but the last use a few of the wavelengths.  Derivatives are differences of solutions,
    which need one solution per parameter and hold for dry and for wet snow.
    """

    solver = DISCRETE_ORDINATES
    # Solutions take little time, so that more descents look for alternative solutions.
    descent_stages = tuple(stage._replace(n_starts=4) for stage in DESCENT_STAGES)

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.n_streams, self._truncation = 0, np.zeros(self.wavelengths.size)
        self._solutions: dict[tuple[bytes, int], np.ndarray] = {}

    def list_extreme_media(self) -> list[Medium]:
        """Return the media in the middle (first) and at the corners of the ranges of each layer.

        Corners without a medium are left out, such as more water than fits into dense snow.
        """
        middle = np.full(len(self.state_vector.names), 0.5)
        media, by_layer = [self.make_inputs(middle)[0]], defaultdict(list)
        for row, name in zip(self.rows, self.names, strict=True):
            if name != INCIDENCE_KEY:
                by_layer[name.split(".")[1] if name.startswith("layers.") else ""].append(row)
        for rows in by_layer.values():
            for corner in product((self.bound_margin, 1.0 - self.bound_margin), repeat=len(rows)):
                state = middle.copy()
                state[rows] = corner
                with suppress(InvalidValue):
                    media.append(self.make_inputs(state)[0])
        return media

    def choose_streams(self, max_error: float) -> None:
        """Set the number of streams that an error requires in the middle of all ranges."""
        medium, incidence, _ = self.make_inputs(np.full(len(self.state_vector.names), 0.5))
        with limit_blas_threads():
            solution = solve_spectrum(
                make_granular_stack(medium, self.wavelengths),
                _compute_cosines(incidence),
                max_error,
            )
        self.n_streams, self._truncation = solution.n_streams, solution.truncation

    def select_values(self, stage: int) -> np.ndarray:
        """Return the positions of the measured values that a stage uses."""
        n_values = self.measurement.values.size
        if stage == LAST_STAGE or self.measurement.bands:
            return np.arange(n_values)
        return choose_trial_wavelengths(n_values)

    def evaluate(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return the modelled measurement, shape (n,)."""
        key = (state.tobytes(), stage)
        if key not in self._solutions:
            self._solutions[key] = self._solve(state, stage)
        return self._solutions[key]

    def _solve(self, state: np.ndarray, stage: int) -> np.ndarray:
        medium, incidence, scale = self.make_inputs(state)
        operator = self.operator[self.select_values(stage)]
        used = np.flatnonzero(operator.any(axis=0))
        snowpack = make_granular_stack(medium, self.wavelengths[used])
        with limit_blas_threads():
            budget = snowpack.solve(_compute_cosines(incidence), self.n_streams)
        # The beam is first, and diffuse light alone where there is none.
        values: np.ndarray = scale * (operator[:, used] @ budget.reflectance[:, 0])
        return values

    def evaluate_with_covariance(
        self, state: np.ndarray, stage: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the modelled measurement, shape (n,), and the covariance of its errors.

        Errors of the tables of grains and of streams are correlated over `ERROR_CORRELATION_NM`.
        """
        medium, _, scale = self.make_inputs(state)
        optics = compute_optics_error(make_granular_stack(medium, self.wavelengths))
        stderr = scale * np.hypot(optics, self._truncation)
        distance = np.abs(self.wavelengths[:, np.newaxis] - self.wavelengths)
        covariance = np.exp(-distance / ERROR_CORRELATION_NM) * np.outer(stderr, stderr)
        operator = self.operator[self.select_values(stage)]
        return self.evaluate(state, stage), operator @ covariance @ operator.T

    def compute_jacobian(self, state: np.ndarray, stage: int) -> np.ndarray:
        """Return the Jacobian with respect to the coordinates, shape (n, parameters)."""
        values, columns = self.evaluate(state, stage), []
        for row in range(len(state)):
            step = -DIFFERENCE_STEP if state[row] > 0.5 else DIFFERENCE_STEP
            shifted = state.copy()
            shifted[row] += step
            columns.append((self._solve(shifted, stage) - values) / step)
        return np.stack(columns, axis=1)

    def compute_final_jacobians(
        self, state: np.ndarray, model_covariance: np.ndarray
    ) -> list[np.ndarray]:
        """Return the Jacobian twice, as it has no noise."""
        return [self.compute_jacobian(state, LAST_STAGE)] * 2


def _compute_cosines(incidence: float | str) -> np.ndarray:
    """Return the cosines of the beams: none for isotropic light."""
    angles = [] if isinstance(incidence, str) else [incidence]
    return np.cos(np.radians(angles))
