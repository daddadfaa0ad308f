"""What a scene has: kernels are compiled for that and carry nothing else."""

from __future__ import annotations

from typing import NamedTuple


class Features(NamedTuple):
    """What a scene has.  A feature is True or None: being types, they decide at compile time.

    Attributes
    ----------
    wet : True or None
        Some legs run through wet pores.
    foggy : True or None
        Dry pores absorb.
    faceted : True or None
        Grains are not all smooth.
    absorbing : True or None
        Extinction coefficients show in reflection.
    mixed : True or None
        Several types, or coatings; includes `absorbing`.
    variant : True or None
        Readings of the papers other than the default in entry point, facets or wrong side, or
        grains that are skipped.
    layered : True or None
        There are several layers; includes `mixed`.
    positions : True or None
        Horizontal positions are tracked.
    orders : True or None
        Grains met are counted, and limited.
    """

    wet: bool | None
    foggy: bool | None
    faceted: bool | None
    absorbing: bool | None
    mixed: bool | None
    variant: bool | None
    layered: bool | None
    positions: bool | None
    orders: bool | None


EVERYTHING = Features(*[True] * len(Features._fields))
"""What the scalar kernel is compiled for."""
