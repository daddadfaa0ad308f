"""Materials: complex refractive indices with range and source, mixing rules and densities."""

from splits.materials.library import (
    MINERAL_DENSITY_KG_M3,
    absorption_coefficient,
    ice_density,
    list_datasets,
    make_refractive_index,
    parse_refractive_index,
)
from splits.materials.refractive_index import (
    MIXING_RULES,
    ConstantIndex,
    LorentzIndex,
    LorentzOscillator,
    RefractiveIndex,
    ScaledIndex,
    SellmeierIndex,
    TabulatedIndex,
    linear_mixing,
    maxwell_garnett,
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
