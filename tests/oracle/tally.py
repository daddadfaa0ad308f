"""Exits of rays: their position, direction, weight and path lengths.

The kernel records exits without reference to a wavelength; the path lengths in each material then
determine the weight of a ray at every wavelength (SPLITSnow Eqs 5-6, with the exponential as the
probability of transmission).
"""

import numpy as np

from oracle.jit import kernel

EXIT_SIDE = 0
"""Column of the side: 0 reflected, 1 transmitted, −1 for rays that did not leave."""
EXIT_WEIGHT = 1
"""Column of the inverse probability of having survived roulette."""
EXIT_ORDER = 2
"""Column of the order of scattering; NaN where a kernel does not count them."""
EXIT_DIRECTION = 3
"""First of three columns: direction outside the slab."""
EXIT_POSITION = 6
"""First of two columns: horizontal position (m); NaN where a kernel does not track it."""
EXIT_LENGTH = 8
"""First of the columns of path lengths (m), one per material."""


def allocate_exits(rays: int, materials: int) -> np.ndarray:
    """Return an empty array of exits, float64[rays, columns], one row per ray."""
    rows = np.full((rays, EXIT_LENGTH + materials), np.nan)
    rows[:, EXIT_SIDE] = -1.0
    return rows


@kernel
def record_exit(row, reflected, x, y, dx, dy, dz, weight, order):
    """Write the exit of a ray into its row, except for the path lengths."""
    row[EXIT_SIDE] = 0.0 if reflected else 1.0
    row[EXIT_WEIGHT] = weight
    row[EXIT_ORDER] = order
    row[EXIT_DIRECTION], row[EXIT_DIRECTION + 1], row[EXIT_DIRECTION + 2] = dx, dy, dz
    row[EXIT_POSITION], row[EXIT_POSITION + 1] = x, y
