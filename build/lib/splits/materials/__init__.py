"""What matter is: complex refractive indices with range and source, mixtures, and densities."""

from splits.materials.datasets import dataset_names
from splits.materials.density import MINERAL_KG_M3, ice_density
from splits.materials.kinds import Constant, RefractiveIndex, Scaled, Sellmeier, Tabulated
from splits.materials.mixing import MIXING, linear, maxwell_garnett
from splits.materials.oscillators import Band, Oscillators
from splits.materials.refractive_index import (
    absorption_coefficient,
    given_index,
    refractive_index,
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
