"""From rays that left to sums of weights over wavelengths.

Kernels record where and with which path lengths a ray left, and know no wavelength; the lengths
in each material then give its weight at every wavelength (SPLITSnow Eqs 5-6, the exponential read
as the probability to pass).
"""

from __future__ import annotations

import numpy as np

from oracle.jit import kernel

EXIT_SIDE = 0
"""Column of the side: 0 reflected, 1 transmitted, −1 for rays that did not leave."""
EXIT_WEIGHT = 1
"""Column of the inverse probability of having survived roulette."""
EXIT_ORDER = 2
"""Column of the order of scattering: grains met; NaN where a kernel does not count them."""
EXIT_DIRECTION = 3
"""First of three columns: direction outside the slab."""
EXIT_POSITION = 6
"""First of two columns: horizontal position (m); NaN where a kernel does not track it."""
EXIT_LENGTH = 8
"""First of the columns of path lengths (m), one per material."""


def exit_rows(rays: int, materials: int) -> np.ndarray:
    """Return room for so many rays, float64[rays, columns]: a row each, none having left."""
    rows = np.full((rays, EXIT_LENGTH + materials), np.nan)
    rows[:, EXIT_SIDE] = -1.0
    return rows


@kernel
def record(row, reflected, x, y, dx, dy, dz, weight, order):
    """Write where and how a ray left into its row; path lengths are left to the caller."""
    row[EXIT_SIDE] = 0.0 if reflected else 1.0
    row[EXIT_WEIGHT] = weight
    row[EXIT_ORDER] = order
    row[EXIT_DIRECTION], row[EXIT_DIRECTION + 1], row[EXIT_DIRECTION + 2] = dx, dy, dz
    row[EXIT_POSITION], row[EXIT_POSITION + 1] = x, y
