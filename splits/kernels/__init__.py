"""Numba kernels of light transport, in SI units and plain arrays.

Nothing in this package imports the rest of `splits` except `splits.core`.  Kernels outside
`vectorized` also run as plain Python with ``NUMBA_DISABLE_JIT=1``, for spheroids only: other shapes
of grains are selected by the compiler (`splits.kernels.compiler.jit.specialize`).  Machine code is
cached on disk (`splits.kernels.compiler.cache`).
"""
