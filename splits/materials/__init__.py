"""Materials: complex refractive indices with range and source, mixing rules and densities."""

from splits.materials.density import MINERAL_DENSITY_KG_M3, ice_density
from splits.materials.library import list_datasets
from splits.materials.lookup import (
    absorption_coefficient,
    make_refractive_index,
    parse_refractive_index,
)
from splits.materials.lorentz import LorentzIndex, LorentzOscillator
from splits.materials.mixing import MIXING_RULES, linear_mixing, maxwell_garnett
from splits.materials.refractive_index import (
    ConstantIndex,
    RefractiveIndex,
    ScaledIndex,
    SellmeierIndex,
    TabulatedIndex,
)

__all__ = [
    "MINERAL_DENSITY_KG_M3",
    "MIXING_RULES",
    "ConstantIndex",
    "LorentzIndex",
    "LorentzOscillator",
    "RefractiveIndex",
    "ScaledIndex",
    "SellmeierIndex",
    "TabulatedIndex",
    "absorption_coefficient",
    "ice_density",
    "linear_mixing",
    "list_datasets",
    "make_refractive_index",
    "maxwell_garnett",
    "parse_refractive_index",
]
