"""Derivative tallies compared with finite differences of the weight tallies."""

import numpy as np
import pytest

from splits.kernels.records import (
    BLOCK_SIZE,
    CROSSING_CODE,
    CROSSING_LENGTH,
    CROSSING_RAY,
    CROSSING_WEIGHT,
    EXIT_LENGTH,
    EXIT_SIDE,
    EXIT_WEIGHT,
    allocate_exits,
)
from splits.kernels.tallies.exits import tally_derivatives, tally_weights

RAYS, MATERIALS, WAVELENGTHS, PARAMETERS = 48, 3, 5, 2
STEP = 1e-2


def make_rays(ground: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return exits and crossings of synthetic rays that hit the ground up to three times."""
    rng = np.random.default_rng(5)
    exits = allocate_exits(RAYS, MATERIALS + ground)
    exits[:, EXIT_SIDE] = rng.choice([-1.0, 0.0] if ground else [-1.0, 0.0, 1.0], RAYS)
    exits[:, EXIT_WEIGHT] = rng.uniform(1.0, 3.0, RAYS)
    lengths = rng.exponential(1.0, (RAYS, MATERIALS))
    exits[:, EXIT_LENGTH : EXIT_LENGTH + MATERIALS] = lengths
    rows = []
    if ground:
        n_hits = rng.integers(0, 4, RAYS)
        exits[:, -1] = n_hits
        for ray, n_crossings in enumerate(n_hits):
            for number in range(n_crossings):
                row = np.zeros(CROSSING_LENGTH + MATERIALS + 1)
                row[CROSSING_RAY], row[CROSSING_CODE] = ray, 2
                row[CROSSING_WEIGHT] = 1.5
                row[CROSSING_LENGTH:-1] = lengths[ray] * (number + 1.0) / (n_crossings + 1.0)
                row[-1] = number
                rows.append(row)
    return exits, np.array(rows).reshape(-1, CROSSING_LENGTH + MATERIALS + ground)


@pytest.mark.parametrize("ground", [False, True])
def test_derivatives_match_differences_of_tallies(ground):
    """Central differences of the same rays have an error of second order in the step."""
    exits, crossings = make_rays(ground)
    columns = MATERIALS + ground
    rng = np.random.default_rng(6)
    absorption = rng.uniform(0.1, 1.0, (WAVELENGTHS, columns))
    changes = rng.uniform(-1.0, 1.0, (PARAMETERS, WAVELENGTHS, columns))
    column = MATERIALS if ground else -1
    derivatives = tally_derivatives(exits, crossings, absorption, changes, column)
    assert derivatives.shape == (RAYS // BLOCK_SIZE, 2, PARAMETERS, WAVELENGTHS)
    for parameter, change in enumerate(changes):
        above, below = (
            tally_weights(exits, crossings, perturbed, True, column).moments[:2, 0]
            for perturbed in (absorption + STEP * change, absorption - STEP * change)
        )
        difference = (above - below) / (2.0 * STEP)
        # Weights are in single precision, and third derivatives about 30 times the first.
        assert derivatives[:, :, parameter].sum(axis=0) == pytest.approx(
            difference, rel=0, abs=1e-3 * RAYS
        )
        assert np.abs(difference).max() > 0.1
