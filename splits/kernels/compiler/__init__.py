"""Compilation, caching and compile-time specialization of the kernels."""
