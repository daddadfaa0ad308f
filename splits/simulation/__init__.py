"""The engine between instruments and kernels: scenes, tracing, tallies, estimates."""
