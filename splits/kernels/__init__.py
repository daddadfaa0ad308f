"""Light transport kernels: numbers in, numbers out.

Nothing in this folder imports the rest of the package, but for `splits.core.atomic`.  Every function is a
small Numba kernel; those outside `lanes` also run as plain Python with ``NUMBA_DISABLE_JIT=1``.
Machine code is kept between processes (`splits.kernels.compiler.cache`).
"""

from __future__ import annotations

import warnings

import numba

if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
    # The random stream wraps around 2**64 on purpose; NumPy scalars warn about it, machine
    # integers do not.
    warnings.filterwarnings("ignore", "overflow encountered", RuntimeWarning)
