"""Vectorized, event-based kernel: many rays on SIMD lanes, in single precision.

A scalar kernel spends much of its time in rejection loops and branches.  Here `N_LANES` rays
advance together.  Two passes over all lanes alternate; each is a loop without branches, in which
every ``if`` selects values only:

`run_flight_pass`   plays roulette and samples the next grain, for lanes between grains;
`run_surface_pass`  samples one interaction (facet, Fresnel, direction, chord), for lanes at a
grain.

After a rejected interaction or grain a lane is handled by the next pass.  Rare events (boundaries,
new rays) are handled in a plain loop between the passes.  The formulas are those of the scalar
kernel: `surface`, `interface` and `spheroid` serve both.
"""

from splits.kernels.vectorized.trace import trace_rays

__all__ = [
    "trace_rays",
]
