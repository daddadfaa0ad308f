"""Fluids in the pore space between grains: air, water and others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from splits.core.validation import ROUNDING_TOLERANCE, check_range, invalid
from splits.kernels.scene import DRY_PORE
from splits.materials import RefractiveIndex
from splits.media.medium import Interface

AIR, WATER = "air", "water"


class PoreFluids(NamedTuple):
    """Pore fluids, in the order of their columns in index arrays.

    A path segment through the pore space lies in one fluid, sampled by these fractions (SPLITSnow
    section 3.4).

    Attributes
    ----------
    names : tuple of str
        Names of the fluids: air in dry pores, then water, then others.
    fractions : tuple of float
        Fractions of the pore space, with a sum of 1.
    """

    names: tuple[str, ...]
    fractions: tuple[float, ...]

    @classmethod
    def from_saturation(cls, saturation: float, other_fluids: Mapping[str, float]) -> PoreFluids:
        """Return the pore fluids for a saturation and other fluids; the rest is air."""
        dry = max(1.0 - saturation - sum(other_fluids.values()), 0.0)
        return cls((AIR, WATER, *other_fluids), (dry, saturation, *other_fluids.values()))

    def list_grain_interfaces(
        self, grain_material: int, probability: float = 1.0
    ) -> list[Interface]:
        """Return the interfaces of the pores with grains that are hit with a given probability."""
        return [
            Interface(probability * fraction, column, grain_material)
            for column, fraction in enumerate(self.fractions)
        ]

    def list_boundary_interfaces(self, with_fresnel: bool) -> list[Interface]:
        """Return the interfaces of filled pores with dry pores at the boundaries."""
        return [
            Interface(fraction, DRY_PORE, column, "boundary")
            for column, fraction in enumerate(self.fractions)
            if with_fresnel and column != DRY_PORE and fraction > 0.0
        ]

    def fill_refractive_indices(
        self,
        index: np.ndarray,
        refractive_index: Mapping[str, RefractiveIndex],
        wavelength_nm: np.ndarray,
    ) -> None:
        """Write the refractive indices of the fluids present into their columns."""
        for column, (name, fraction) in enumerate(zip(self.names, self.fractions, strict=True)):
            if name in refractive_index and (fraction > 0.0 or column == DRY_PORE):
                index[:, column] = refractive_index[name](wavelength_nm)


def check_other_fluids(
    pores: Any, saturation: float, refractive_index: Any, grain_materials: Iterable[str]
) -> dict[str, float]:
    """Return the validated fractions of fluids other than air and water.

    Parameters
    ----------
    pores : mapping
        Fractions of the pore space by name.
    saturation : float
    refractive_index : mapping
        As given by the user; it must define each of these fluids.
    grain_materials : iterable of str
        Names of the materials of grains, which are reserved.
    """
    if not isinstance(pores, Mapping):
        raise invalid("pores", pores, "a mapping of fractions of the pore space by medium")
    reserved = (AIR, WATER, *grain_materials)
    fractions = {}
    for name, fraction in pores.items():
        if not isinstance(name, str) or not name.isidentifier() or name in reserved:
            hint = "saturation is the fraction of water, and air fills the rest"
            raise invalid("pores", name, f"names other than {', '.join(reserved)}", hint)
        fractions[name] = check_range(f"pores.{name}", fraction, 0.0, 1.0, open_low=True)
        if not isinstance(refractive_index, Mapping) or name not in refractive_index:
            hint = f"give refractive_index of {name}: n + kj or a table"
            raise invalid("pores", name, "media of known refractive index", hint)
    total = saturation + sum(fractions.values())
    if total > 1.0 + ROUNDING_TOLERANCE:
        raise invalid("pores", dict(pores), "fractions that add up to at most 1 - saturation")
    return fractions
