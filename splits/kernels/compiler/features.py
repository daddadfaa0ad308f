"""Features of a scene for which kernels are specialized at compile time.

Code of absent features is compiled away.  Features that cost no measurable time are always
compiled (benchmarks/kernels.py): the interpretations of the papers, horizontal positions, and the
order of scattering.
"""

from __future__ import annotations

from typing import NamedTuple


class Features(NamedTuple):
    """Features of a scene, each True or None.

    The two values differ in type, so that branches on them are decided at compile time.

    Attributes
    ----------
    wet : True or None
        Some path segments run through wet pores.
    faceted : True or None
        Some grains are rough.
    absorbing : True or None
        Extinction coefficients affect reflection.
    mixed : True or None
        There are several grain types, or coatings; includes `absorbing`.
    layered : True or None
        There are several layers; includes `mixed`.
    """

    wet: bool | None
    faceted: bool | None
    absorbing: bool | None
    mixed: bool | None
    layered: bool | None


ALL_FEATURES = Features(*[True] * len(Features._fields))
"""Features of the scalar kernel."""
