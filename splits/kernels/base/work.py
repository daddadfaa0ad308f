"""Work of a kernel call: the rays that it traces, one integer in each column."""

from __future__ import annotations

STREAM, FIRST_RAY, N_RAYS, MAX_ORDER = range(4)
"""Columns of the work: stream, first ray, number of rays, and order of scattering after which a ray
counts as absorbed.

Seed, stream and ray determine the random numbers of a ray, so that results do not depend on the
division of rays into calls.  All wavelengths that share paths use one stream.
"""

NO_MAX_ORDER = 2**31 - 1
"""Largest order of scattering if it is unlimited."""
