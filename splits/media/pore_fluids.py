"""What fills the pores between grains: air, water, and whatever else a sample holds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from splits.core.validation import ROUNDING_TOLERANCE, check_range, invalid
from splits.kernels.grains.scene import DRY_PORE
from splits.materials import RefractiveIndex
from splits.media.medium import Interface

AIR, WATER = "air", "water"


class PoreFluids(NamedTuple):
    """Media that share the pore space, in the order of their columns.

    A leg through the pore space runs in one of them, drawn by these shares (SPLITSnow section 3.4).

    Attributes
    ----------
    names : tuple of str
        Dry pores first, then water, then others.
    fractions : tuple of float
        Of the pore space; they sum to 1.
    """

    names: tuple[str, ...]
    fractions: tuple[float, ...]

    @classmethod
    def from_saturation(cls, saturation: float, other_fluids: Mapping[str, float]) -> PoreFluids:
        """Return the pores of so much water and of others; the rest is dry."""
        dry = max(1.0 - saturation - sum(other_fluids.values()), 0.0)
        return cls((AIR, WATER, *other_fluids), (dry, saturation, *other_fluids.values()))

    def list_grain_interfaces(
        self, grain_material: int, probability: float = 1.0
    ) -> list[Interface]:
        """Return what grains of a material, met with a probability, have in common with pores."""
        return [
            Interface(probability * part, row, grain_material)
            for row, part in enumerate(self.fractions)
        ]

    def list_boundary_interfaces(self, with_fresnel: bool) -> list[Interface]:
        """Return what wet pores have in common with the dry ones outside, if Fresnel acts there."""
        return [
            Interface(part, DRY_PORE, row, "face")
            for row, part in enumerate(self.fractions)
            if with_fresnel and row != DRY_PORE and part > 0.0
        ]

    def fill_refractive_indices(
        self,
        index: np.ndarray,
        refractive_index: Mapping[str, RefractiveIndex],
        wavelength_nm: np.ndarray,
    ) -> None:
        """Write refractive indices of media that are there into their columns."""
        for row, (name, part) in enumerate(zip(self.names, self.fractions, strict=True)):
            if name in refractive_index and (part > 0.0 or row == DRY_PORE):
                index[:, row] = refractive_index[name](wavelength_nm)


def check_other_fluids(
    pores: Any, saturation: float, refractive_index: Any, grain_materials: Iterable[str]
) -> dict[str, float]:
    """Return the shares of media other than air and water, or refuse them.

    Parameters
    ----------
    pores : mapping
        Shares of the pore space by name.
    saturation : float
    refractive_index : mapping
        As given by the user, who has to say what such a medium is.
    grain_materials : iterable of str
        Names of the materials of grains.
    """
    if not isinstance(pores, Mapping):
        raise invalid("pores", pores, "a mapping of shares of the pore space by medium")
    reserved = (AIR, WATER, *grain_materials)
    shares = {}
    for name, share in pores.items():
        if not isinstance(name, str) or not name.isidentifier() or name in reserved:
            hint = "water is saturation, air the rest"
            raise invalid("pores", name, f"names other than {', '.join(reserved)}", hint)
        shares[name] = check_range(f"pores.{name}", share, 0.0, 1.0, open_low=True)
        if not isinstance(refractive_index, Mapping) or name not in refractive_index:
            hint = f"give refractive_index of {name}: n + kj, a table"
            raise invalid("pores", name, "media of known refractive index", hint)
    total = saturation + sum(shares.values())
    if total > 1.0 + ROUNDING_TOLERANCE:
        raise invalid("pores", dict(pores), "shares that leave saturation room: at most 1 together")
    return shares
