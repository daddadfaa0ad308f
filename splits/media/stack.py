"""A stack: media of grains on top of one another, as one sample."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, cast

import numpy as np

from splits.core.validation import (
    check_choice,
    invalid,
    key_prefix,
    reject_unknown_keywords,
    suggest_name,
)
from splits.kernels.grains.scene import WET_PORE
from splits.media.formatting import format_value
from splits.media.ground import Ground, describe_ground
from splits.media.interpretations import INTERPRETATION_SETS
from splits.media.medium import GranularMedium, Interface
from splits.media.particle_layer import ParticleLayer
from splits.media.pore_fluids import PoreFluids
from splits.media.stacked_particle_layer import StackedParticleLayer

MAX_LAYERS = 200


@reject_unknown_keywords
@dataclass(frozen=True, repr=False)
class Stack:
    """Media of grains in order, top first.

    Between them nothing optical stands.  The pore of a leg is drawn once, so it changes at an
    interface only where saturations differ; there Fresnel's laws act.  A grain belongs to the
    layer in which a ray meets it, and is kept where it reaches across an interface, so that a
    medium cut in two answers as the whole.

    Parameters
    ----------
    layers : sequence of Snow, Sand or ParticleLayer
        Top first, 1 to 200.  Readings of transport must be the same in all layers of grains; none
        of them has a ground of its own.  A `StackedParticleLayer` has no bottom here, and a rough surface only
        as the first.
    ground : number, str, mapping or path, optional
        Lambertian ground below: an albedo, "black", the name of a soil, a table; see
        `splits.media.ground.Ground.from_input`.  By default light leaves below ("open").
    interpretation : str, optional
        Name of a set of readings, see `splits.media.interpretations.INTERPRETATION_SETS`, that all layers of grains take
        in place of their own: snow and sand have different ones by default.

    Raises
    ------
    ValueError
        For a value outside its range; the message names the layer.

    Examples
    --------
    >>> from splits import Snow, Stack
    >>> fresh = Snow(grain_size_um=(50, 100), density_kg_m3=120, depth_m=0.02)
    >>> round(Stack([fresh, Snow()]).depth_m, 6)
    0.14
    """

    kind = "stack"

    layers: tuple[GranularMedium | ParticleLayer, ...]
    ground: Any = None
    interpretation: str | None = None

    def __post_init__(self) -> None:
        if isinstance(self.layers, str | GranularMedium | ParticleLayer) or not isinstance(
            self.layers, Iterable
        ):
            raise invalid("layers", self.layers, "a list of media, top first")
        layers = tuple(self.layers)
        if not 1 <= len(layers) <= MAX_LAYERS:
            raise invalid("layers", f"{len(layers)} layers", f"1 to {MAX_LAYERS}")
        for number, layer in enumerate(layers):
            if isinstance(layer, ParticleLayer):
                with key_prefix(f"layers[{number}]"):
                    StackedParticleLayer(layer, number == 0)
                continue
            if isinstance(layer, type) or not isinstance(layer, GranularMedium):
                given = getattr(layer, "kind", layer)
                near = suggest_name(str(given).capitalize(), ["Snow", "Sand", "ParticleLayer"])
                allowed = "splits.Snow(...), splits.Sand(...) or splits.ParticleLayer(...)"
                raise invalid(f"layers[{number}]", given, allowed, near)
            if layer.depth_m == math.inf and number < len(layers) - 1:
                hint = "only the lowest layer has no end"
                raise invalid(f"layers[{number}].depth_m", math.inf, "finite", hint)
            if layer.ground is not None:
                hint = "give it to the stack"
                raise invalid(f"layers[{number}].ground", layer.ground.name, "left out", hint)
        if self.interpretation is not None:
            layers = tuple(self._apply_interpretation(layer) for layer in layers)
        grains = [(i, one) for i, one in enumerate(layers) if not isinstance(one, ParticleLayer)]
        for number, layer in grains:
            top, first = grains[0]
            if layer.interpretation.to_transport_dict() != first.interpretation.to_transport_dict():
                raise invalid(
                    f"layers[{number}].interpretation", layer.interpretation.as_dict(),
                    f"those of layers[{top}], {first.interpretation.as_dict()}",
                    "one set holds for all: Stack(..., interpretation='radiative_transfer')",
                )  # fmt: skip
        object.__setattr__(self, "layers", layers)
        object.__setattr__(self, "ground", Ground.from_input(self.ground))

    def __repr__(self) -> str:
        """Return the stack, a layer to a line, as it was given."""
        inputs = {"ground": self.ground, "interpretation": self.interpretation}
        ends = [
            f", {key}={format_value(value)}" for key, value in inputs.items() if value is not None
        ]
        lines = ["Stack([", *(f"    {layer!r}," for layer in self.layers), f"]{''.join(ends)})"]
        return "\n".join(lines)

    def _apply_interpretation(
        self, layer: GranularMedium | ParticleLayer
    ) -> GranularMedium | ParticleLayer:
        """Return a layer with the stack's readings."""
        if isinstance(layer, ParticleLayer):
            return layer
        own: Any = layer.interpretation
        chosen = INTERPRETATION_SETS[
            check_choice("interpretation", self.interpretation, INTERPRETATION_SETS)
        ]
        return replace(
            cast(Any, layer), interpretation=type(own).from_input({**own.as_dict(), **chosen})
        )

    @cached_property
    def scene_layers(self) -> tuple[GranularMedium | StackedParticleLayer, ...]:
        """The layers as scenes take them."""
        return tuple(
            StackedParticleLayer(layer, number == 0) if isinstance(layer, ParticleLayer) else layer
            for number, layer in enumerate(self.layers)
        )

    @property
    def depth_m(self) -> float:
        """Thickness of all layers together (m)."""
        return float(np.cumsum([part.depth_m for part in self.scene_layers])[-1])

    @property
    def largest_grain_m(self) -> float:
        """Diameter of the largest grain of all layers (m)."""
        return max(part.largest_grain_m for part in self.scene_layers)

    def list_materials(self) -> tuple[str, ...]:
        """Return the names of the materials, layer by layer."""
        return tuple(
            f"layers.{number}.{name}"
            for number, layer in enumerate(self.scene_layers)
            for name in layer.list_materials()
        )

    def list_interfaces(self) -> list[Interface]:
        """Return the pairs of materials that meet within each layer, and at faces of particles'."""
        found = []
        first = np.cumsum([0, *(len(part.list_materials()) for part in self.scene_layers)]).tolist()
        for number, layer in enumerate(self.scene_layers):
            found += [
                Interface(
                    i.fraction,
                    i.outer_material + first[number],
                    i.inner_material + first[number],
                    i.location,
                    number,
                )
                for i in layer.list_interfaces()
            ]
        for upper, lower in pairwise(range(len(self.scene_layers))):
            for one, other in ((upper, lower), (lower, upper)):
                found += self._list_boundary_interfaces(one, other, first)
        return found

    def _list_boundary_interfaces(
        self, number: int, neighbour_number: int, first_columns: list[int]
    ) -> list[Interface]:
        """Return what the pores of one layer of grains have in common with its neighbour."""
        grains, neighbour = self.scene_layers[number], self.scene_layers[neighbour_number]
        if isinstance(grains, StackedParticleLayer):
            return []
        shares = PoreFluids.from_saturation(grains.wet_fraction, grains.pores).fractions
        matrix = isinstance(neighbour, StackedParticleLayer)
        if not matrix and not grains.interpretation.to_sampling_rules().boundary_fresnel:
            return []
        # Air and water of two layers of grains may have tables of their own.
        rows = [
            (r, WET_PORE if matrix else r) for r in range(len(shares)) if matrix or r <= WET_PORE
        ]
        return [
            Interface(
                shares[row],
                first_columns[neighbour_number] + beyond,
                first_columns[number] + row,
                "face",
                number,
            )
            for row, beyond in rows
            if shares[row] > 0.0
        ]

    def compute_refractive_indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return complex refractive indices, shape (wavelengths, materials)."""
        return np.concatenate(
            [layer.compute_refractive_indices(wavelength_nm) for layer in self.scene_layers], axis=1
        )

    def describe(self) -> dict[str, Any]:
        """Return inputs and derived quantities of all layers, for a dataset's attributes."""
        facts: dict[str, Any] = {"depth_m": self.depth_m}
        for number, layer in enumerate(self.scene_layers):
            facts[f"layers_{number}_kind"] = self.layers[number].kind
            described = layer.describe()
            described.pop("ground", None)
            facts |= {f"layers_{number}_{key}": value for key, value in described.items()}
        return facts | describe_ground(self.ground)
