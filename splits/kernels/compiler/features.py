"""What a scene has: kernels are compiled for that and carry nothing else that costs time.

What costs none is compiled in always (benchmarks/kernels.py): the papers' readings, horizontal
positions, the number of grains met.
"""

from __future__ import annotations

from typing import NamedTuple


class Features(NamedTuple):
    """What a scene has.  A feature is True or None: being types, they decide at compile time.

    Attributes
    ----------
    wet : True or None
        Some legs run through wet pores.
    faceted : True or None
        Grains are not all smooth.
    absorbing : True or None
        Extinction coefficients show in reflection.
    mixed : True or None
        Several types, or coatings; includes `absorbing`.
    layered : True or None
        There are several layers; includes `mixed`.
    """

    wet: bool | None
    faceted: bool | None
    absorbing: bool | None
    mixed: bool | None
    layered: bool | None


ALL_FEATURES = Features(*[True] * len(Features._fields))
"""What the scalar kernel is compiled for."""
