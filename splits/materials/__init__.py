"""What matter is: complex refractive indices with range and source, mixtures, and densities."""

from splits.materials.library import list_datasets
from splits.materials.density import MINERAL_DENSITY_KG_M3, ice_density
from splits.materials.refractive_index import (
    ConstantIndex,
    RefractiveIndex,
    ScaledIndex,
    SellmeierIndex,
    TabulatedIndex,
)
from splits.materials.mixing import MIXING_RULES, linear_mixing, maxwell_garnett
from splits.materials.lorentz import LorentzOscillator, LorentzIndex
from splits.materials.lookup import (
    absorption_coefficient,
    parse_refractive_index,
    make_refractive_index,
)

__all__ = [
    "MINERAL_KG_M3",
    "MIXING",
    "Band",
    "Constant",
    "Oscillators",
    "RefractiveIndex",
    "Scaled",
    "Sellmeier",
    "Tabulated",
    "absorption_coefficient",
    "dataset_names",
    "given_index",
    "ice_density",
    "linear",
    "maxwell_garnett",
    "refractive_index",
]
