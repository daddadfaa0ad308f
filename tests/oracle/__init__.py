"""An independent, earlier version of the scalar kernel of grains, used as a reference.

It shares no code with `splits.kernels`, so that agreement with it is independent evidence.  The
numbers that it computes must not change when the package changes.
"""
