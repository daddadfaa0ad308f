"""Derivatives of sums of weights, against differences of the sums themselves."""

from __future__ import annotations

import numpy as np
import pytest

from splits.kernels.tallies.crossings import (
    CROSSING_EVENT,
    CROSSING_LENGTH,
    CROSSING_RAY,
    CROSSING_WEIGHT,
)
from splits.kernels.tallies.derivatives import tally_derivatives
from splits.kernels.tallies.exits import (
    BLOCK_SIZE,
    EXIT_LENGTH,
    EXIT_SIDE,
    EXIT_WEIGHT,
    allocate_exits,
    tally_weights,
)

RAYS, MATERIALS, WAVELENGTHS, PARAMETERS = 48, 3, 5, 2
STEP = 1e-2


def make_rays(ground: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return exits and records of synthetic rays, which hit the ground up to three times."""
    rng = np.random.default_rng(5)
    exits = allocate_exits(RAYS, MATERIALS + ground)
    exits[:, EXIT_SIDE] = rng.choice([-1.0, 0.0] if ground else [-1.0, 0.0, 1.0], RAYS)
    exits[:, EXIT_WEIGHT] = rng.uniform(1.0, 3.0, RAYS)
    lengths = rng.exponential(1.0, (RAYS, MATERIALS))
    exits[:, EXIT_LENGTH : EXIT_LENGTH + MATERIALS] = lengths
    rows = []
    if ground:
        meetings = rng.integers(0, 4, RAYS)
        exits[:, -1] = meetings
        for ray, count in enumerate(meetings):
            for number in range(count):
                row = np.zeros(CROSSING_LENGTH + MATERIALS + 1)
                row[CROSSING_RAY], row[CROSSING_EVENT] = ray, 2
                row[CROSSING_WEIGHT] = 1.5
                row[CROSSING_LENGTH:-1] = lengths[ray] * (number + 1.0) / (count + 1.0)
                row[-1] = number
                rows.append(row)
    return exits, np.array(rows).reshape(-1, CROSSING_LENGTH + MATERIALS + ground)


@pytest.mark.parametrize("ground", [False, True])
def test_derivatives_are_those_of_the_sums(ground):
    """Central differences of the same rays, whose own error goes with the square of the step."""
    exits, notes = make_rays(ground)
    columns = MATERIALS + ground
    rng = np.random.default_rng(6)
    absorption = rng.uniform(0.1, 1.0, (WAVELENGTHS, columns))
    changes = rng.uniform(-1.0, 1.0, (PARAMETERS, WAVELENGTHS, columns))
    column = MATERIALS if ground else -1
    found = tally_derivatives(exits, notes, absorption, changes, column)
    assert found.shape == (RAYS // BLOCK_SIZE, 2, PARAMETERS, WAVELENGTHS)
    for parameter, change in enumerate(changes):
        above, below = (
            tally_weights(exits, notes, absorption + sign * STEP * change, True, column)[0][:2, 0]
            for sign in (1.0, -1.0)
        )
        difference = (above - below) / (2.0 * STEP)
        # Weights are in single precision, and third derivatives about 30 times the first.
        assert found[:, :, parameter].sum(axis=0) == pytest.approx(
            difference, rel=0, abs=1e-3 * RAYS
        )
        assert np.abs(difference).max() > 0.1
