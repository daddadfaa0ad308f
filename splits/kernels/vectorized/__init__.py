"""The lane kernel: many rays side by side in single precision, for compilers to vectorise.

A scalar kernel waits for its rejection loops and branches.  Here `LANES` rays advance together;
two passes over all lanes alternate, each a loop without branches, whose ``if`` only select values:

`flight`    plays roulette, draws the next grain and the way to it, for lanes between grains;
`surface`   is one trial at a grain's surface (facet, Fresnel, direction, chord), for lanes at one.

A trial that is rejected, or a grain that does not fit, just waits for the next pass.  What is
rare (boundaries, launches) is a plain loop in between.
The formulas are those of the scalar kernel: `facets`, `fresnel`, `spheroid` serve both.
"""

from splits.kernels.vectorized.batch import trace_batch

__all__ = [
    "trace_batch",
]
