"""What all media hand to an instrument, and what granular ones do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from splits.checks import refuse
from splits.materials.refractive_index import absorption_coefficient
from splits.media.ground import Ground
from splits.media.readings import TransportReadings
from splits.transport.grains.scene import Grains

PORES = 2
"""Materials of dry and wet pores, which come first; those of other pores follow."""


class Interface(NamedTuple):
    """Two materials that meet, and the share of all meetings of light with grains that is theirs.

    Attributes
    ----------
    share : float
        Of meetings with grains; of a face, that of the light that meets it.
    near, far : int
        Materials on the outer and on the inner side.
    place : {"outer", "inner", "face"}
        Between pores and grains; within grains; at a face of the sample, where wet pores meet dry
        ones, or what particles lie in.
    layer : int
        Of the sample.
    """

    fraction: float
    outer_material: int
    inner_material: int
    location: str = "outer"
    layer: int = 0


class Described(Protocol):
    """What all media tell instruments: their materials and all of their inputs."""

    @property
    def kind(self) -> str:
        """What sort of medium this is, as configuration files name it."""
        ...

    def list_materials(self) -> tuple[str, ...]:
        """Return the names of the materials; of grains, after those of dry and wet pores."""
        ...

    def list_interfaces(self) -> Sequence[Interface]:
        """Return the pairs of materials whose contrast depends on wavelength."""
        ...

    def compute_refractive_indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return complex refractive indices, shape (wavelengths, materials)."""
        ...

    def describe(self) -> dict[str, Any]:
        """Return all inputs and derived quantities, for a dataset's attributes."""
        ...


@runtime_checkable
class Impure(Protocol):
    """A medium that may hold what absorbs besides its materials."""

    def compute_added_absorption(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return what impurities absorb (1/m), shape (wavelengths, materials)."""
        ...


def absorption_of(medium: Described, index: np.ndarray, wavelength_nm: np.ndarray) -> np.ndarray:
    """Return the absorption coefficients (1/m) of a medium's materials, impurities included.

    They apply to recorded lengths (`path_fractions`).

    Parameters
    ----------
    medium : Described
    index : complex, shape (wavelengths, materials)
        Its refractive indices.
    wavelength_nm : float, shape (wavelengths,)
    """
    absorption = absorption_coefficient(index, wavelength_nm[:, np.newaxis])
    absorption *= path_fractions(medium)
    first = 0
    for part in _parts_of(medium):
        count = len(part.list_materials())
        if isinstance(part, Impure):
            absorption[:, first : first + count] += part.compute_added_absorption(wavelength_nm)
        first += count
    return absorption


def path_fractions(medium: Described) -> np.ndarray:
    """Return which fraction of the length recorded in each material is path in it.

    Kernels record whole segments between grains; of those between points, pores are a fraction
    (`pore_fraction`).
    """
    fractions = []
    for part in _parts_of(medium):
        own = np.ones(len(part.list_materials()))
        if isinstance(part, GranularMedium):
            own[: PORES + len(part.pores)] = pore_fraction(part)
        fractions.append(own)
    return np.concatenate(fractions)


def _parts_of(medium: Described) -> Sequence[Any]:
    return medium.scene_layers if isinstance(medium, LayeredMedium) else (medium,)


@runtime_checkable
class LayeredMedium(Described, Protocol):
    """Several granular media, top first."""

    @property
    def depth_m(self) -> float:
        """Thickness (m)."""
        ...

    @property
    def largest_grain_m(self) -> float:
        """Diameter of the largest grain (m)."""
        ...

    @property
    def scene_layers(self) -> Sequence[Any]:
        """Return the media as scenes take them: granular ones, and layers of particles."""
        ...

    @property
    def ground(self) -> Ground | None:
        """What lies below, None where light leaves there."""
        ...


@runtime_checkable
class GranularMedium(Described, Protocol):
    """A slab of grains, as instruments see it: particle table, boundaries, optical constants."""

    @property
    def depth_m(self) -> float:
        """Thickness (m)."""
        ...

    @property
    def saturation(self) -> float:
        """Share of the pore space that is wet."""
        ...

    @property
    def wet_fraction(self) -> float:
        """Probability that a leg through pores runs in water."""
        ...

    @property
    def pores(self) -> Mapping[str, float]:
        """Shares of the pore space that other media fill, by name."""
        ...

    @property
    def largest_grain_m(self) -> float:
        """Diameter of the largest grain (m)."""
        ...

    @property
    def porosity(self) -> float:
        """Share of the volume that is pores."""
        ...

    @property
    def mean_grain_distance_m(self) -> float:
        """Mean distance between grains along a ray (m), as the papers have it."""
        ...

    @property
    def interpretation(self) -> TransportReadings:
        """Named readings of the papers."""
        ...

    @property
    def ground(self) -> Ground | None:
        """What lies below, None where light leaves there."""
        ...

    def make_grain_population(self) -> Grains:
        """Return the table of particle types."""
        ...


def mean_leg_m(medium: GranularMedium) -> float:
    """Return the mean leg (m) that a ray goes from one grain to the next.

    The papers' mean distance 1/(𝓔 K) is that between entries into grains (SPLITSnow Eq A.3), of
    mean chord 1/K.  Counted with the grain, 1 − 𝓔 of it are left for the leg, unless grains are
    points, among which the leg stands for both (`pore_fraction`).
    """
    readings = medium.interpretation
    whole = readings.grain_distance == "leg" or readings.grain_extent == "point"
    return medium.mean_grain_distance_m * (1.0 if whole else medium.porosity)


def pore_fraction(medium: GranularMedium) -> float:
    """Return the fraction of a leg that counts as pore space when it absorbs.

    It is 1 unless grains are points whose distance includes them: then 1 − 𝓔, and the coefficient
    that applies per metre of leg is that of radiative transfer, (1 − 𝓔) times the material's.
    """
    readings = medium.interpretation
    parted = readings.grain_distance == "leg_and_grain" and readings.grain_extent == "point"
    return medium.porosity if parted else 1.0


def check_room(medium: GranularMedium | LayeredMedium) -> None:
    """Refuse a sample that is not thicker than its largest grain."""
    largest = medium.largest_grain_m
    if medium.depth_m <= largest:
        hint = "such a grain must fit between the boundaries"
        raise refuse("depth_m", medium.depth_m, f"more than the largest grain, {largest:g} m", hint)
