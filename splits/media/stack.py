"""Layered media: a stack of granular layers and particle layers."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import fields, replace
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np

from splits.core.arrays import ContentEquality
from splits.core.declarations import Quantity, declare_class
from splits.core.validation import invalid
from splits.kernels.scene import MATRIX, WET_PORE
from splits.media.formatting import format_input, suggest_medium
from splits.media.ground import Ground, GroundInput, check_ground_reached, describe_ground
from splits.media.interpretations import INTERPRETATION_SETS, TransportInterpretation
from splits.media.medium import GranularMedium, Interface, Layer, Medium
from splits.media.particle_layer import DEFAULT_GROUND, ParticleLayer

MAX_LAYERS = 200
UNSUPPORTED_IN_STACK = {
    "surface": (None, "only the top layer of a stack may be rough"),
    "opaque": (False, "all layers of a stack scatter light"),
}
"""Settings of particle layers that are not supported in a stack, with the required value and the
reason."""
MIN_DEPTH_RATIO = 1e-10
"""Smallest thickness of a layer relative to those above, which rounding changes by up to 1e-6."""


def _check_layers(key: str, layers: Any) -> tuple[Any, ...]:
    """Return the layers of a stack, after checking each."""
    is_one = isinstance(layers, str | GranularMedium | ParticleLayer)
    if is_one or not isinstance(layers, Iterable):
        raise invalid(key, layers, "a list of media, top first")
    # Particle layers have their default ground only outside of stacks.
    layers = tuple(
        replace(one, ground=None) if getattr(one, "ground", None) == DEFAULT_GROUND else one
        for one in layers
    )
    last = len(layers) - 1
    if not 1 <= len(layers) <= MAX_LAYERS:
        raise invalid(key, f"{len(layers)} layers", f"1 to {MAX_LAYERS}")
    for number, layer in enumerate(layers):
        own_key = f"{key}[{number}]"
        if isinstance(layer, ParticleLayer):
            for name, (required, reason) in UNSUPPORTED_IN_STACK.items():
                value = getattr(layer, name)
                if value != required and not (name == "surface" and number == 0):
                    allowed = "left out" if required is None else "false"
                    raise invalid(f"{own_key}.{name}", value, allowed, reason)
        elif not isinstance(layer, GranularMedium):
            kind = layer if callable(layer) else getattr(layer, "kind", layer)
            hint = suggest_medium(layer, ["Snow", "Sand", "ParticleLayer"])
            allowed = "splits.Snow(...), splits.Sand(...) or splits.ParticleLayer(...)"
            raise invalid(own_key, kind, allowed, hint)
        thickness = "depth_m" if layer.has_grains else "optical_thickness"
        if layer.is_semi_infinite and number < last:
            hint = "only the lowest layer may be infinite"
            raise invalid(f"{own_key}.{thickness}", math.inf, "finite", hint)
        if layer.ground is not None:
            given, hint = layer.ground.as_input(), "give it to the stack"
            raise invalid(f"{own_key}.ground", given, "left out", hint)
    return layers


Layers = Annotated[Any, Quantity("layers", check=_check_layers, schema={"type": "array"})]
StackInterpretation = Annotated[
    Literal["splits_2007", "splitsnow_2021", "geometric", "radiative_transfer"] | None,
    Quantity("interpretation of the papers"),
]


@declare_class
class Stack(ContentEquality, Medium):
    """Layered medium, top layer first.

    The pore material of a path segment is sampled once.  It changes at a boundary between two
    layers only if their saturations differ; light is reflected and refracted there.  A grain
    belongs to the layer in which a ray hits it, and is accepted even if it overlaps a boundary
    between layers.  Dividing a layer in two therefore changes no result.

    Parameters
    ----------
    layers : sequence of Snow, Sand or ParticleLayer
        Layers from top to bottom, 1 to 200.  All layers of grains must have the same choices of
        `splits.media.interpretations.TransportInterpretation`, and no layer may have a ground
        (that of a `ParticleLayer` by default is left out) or be opaque.  Only the lowest
        layer may be infinite, and only the top layer may have a rough surface.  All
        layers of particles, or none, must be polarized; polarized light is traced through layers of
        grains, too.
    ground : number, str, mapping or path, optional
        Lambertian ground below the stack: an albedo, "black", the name of a soil or a table; see
        `splits.media.ground.Ground.from_input`.  By default light leaves through the lower
        boundary ("open").
    interpretation : str, optional
        Name of a set of `splits.media.interpretations.INTERPRETATION_SETS`.  It replaces the
        interpretation of all layers of grains, because the defaults of snow and sand differ.

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

    layers: Layers
    ground: GroundInput = None
    interpretation: StackInterpretation = None

    def __post_init__(self) -> None:
        layers, last = self.layers, len(self.layers) - 1
        # Rounding of the boundaries must change the thickness of no layer.
        total_m = 0.0
        for number, layer in enumerate(layers):
            if layer.depth_m < MIN_DEPTH_RATIO * total_m:
                allowed = f"at least {MIN_DEPTH_RATIO * total_m:g} m below {total_m:g} m"
                raise invalid(f"layers[{number}].depth_m", layer.depth_m, allowed)
            total_m += layer.depth_m
        granular = {number: layer for number, layer in enumerate(layers) if layer.has_grains}
        if self.interpretation is not None:
            choices = INTERPRETATION_SETS[self.interpretation]
            for number, layer in granular.items():
                merged = type(layer.interpretation)(**{**layer.interpretation.as_dict(), **choices})
                granular[number] = replace(layer, interpretation=merged)
            layers = tuple(granular.get(number, layer) for number, layer in enumerate(layers))
        polarized = [number for number, layer in enumerate(layers) if layer.polarized]
        if 0 < len(polarized) < len(layers) - len(granular):
            allowed = "false, or true for all layers of particles"
            raise invalid(f"layers[{polarized[0]}].polarized", True, allowed)
        rules = [field.name for field in fields(TransportInterpretation)]
        first, top = next(iter(granular.items()), (0, layers[0]))
        for number, layer in granular.items():
            own, others = layer.interpretation.as_dict(), top.interpretation.as_dict()
            if any(own[rule] != others[rule] for rule in rules):
                raise invalid(
                    f"layers[{number}].interpretation", own, f"those of layers[{first}], {others}",
                    "one set applies to all: Stack(..., interpretation='radiative_transfer')",
                )  # fmt: skip
        object.__setattr__(self, "layers", layers)
        object.__setattr__(self, "polarized", bool(polarized))
        check_ground_reached(self.ground, self.is_semi_infinite, f"the infinite layers[{last}]")

    def __repr__(self) -> str:
        """Return the call that constructs the stack, with one layer per line."""
        inputs = {"ground": self.ground, "interpretation": self.interpretation}
        keywords = [
            f", {key}={format_input(value)}" for key, value in inputs.items() if value is not None
        ]
        lines = ["Stack([", *(f"    {layer!r}," for layer in self.layers), f"]{''.join(keywords)})"]
        return "\n".join(lines)

    @property
    def scene_layers(self) -> tuple[Layer, ...]:
        """Layers, top first."""
        return self.layers

    def truncate(self, depth_m: float, ground: Ground | None) -> Stack:
        """Return the stack with a lowest layer of another depth (m), over a ground."""
        lowest = self.lowest_layer.truncate(depth_m, None)
        return replace(self, layers=(*self.layers[:-1], lowest), ground=ground)

    @property
    def depth_m(self) -> float:
        """Total thickness (m)."""
        return float(np.cumsum([layer.depth_m for layer in self.scene_layers])[-1])

    @property
    def largest_grain_m(self) -> float:
        """Diameter of the largest grain of all layers (m)."""
        return max(layer.largest_grain_m for layer in self.scene_layers)

    def list_materials(self) -> tuple[str, ...]:
        """Return the names of the materials of each layer in turn."""
        return tuple(
            f"layers.{number}.{name}"
            for number, layer in enumerate(self.scene_layers)
            for name in layer.list_materials()
        )

    def list_interfaces(self) -> list[Interface]:
        """Return the optical interfaces within layers and at their boundaries."""
        interfaces = []
        first_columns = np.cumsum(
            [0, *(len(scene_layer.list_materials()) for scene_layer in self.scene_layers)]
        ).tolist()
        for number, layer in enumerate(self.scene_layers):
            interfaces += [
                interface._replace(
                    outer_material=interface.outer_material + first_columns[number],
                    inner_material=interface.inner_material + first_columns[number],
                    layer=number,
                )
                for interface in layer.list_interfaces()
            ]
        layers = enumerate(self.scene_layers)
        pairs = [pair for one, two in pairwise(layers) for pair in ((one, two), (two, one))]
        for (number, layer), (other_number, neighbour) in pairs:
            if not layer.has_grains:
                continue
            faces_matrix = not neighbour.has_grains
            if not faces_matrix and not layer.interpretation.to_sampling_rules().boundary_fresnel:
                continue
            for row, fraction in enumerate(layer.pore_fluids.fractions):
                # Air and water of two granular layers may have different tables.
                if fraction > 0.0 and (faces_matrix or row <= WET_PORE):
                    outer = first_columns[other_number] + (MATRIX if faces_matrix else row)
                    inner = first_columns[number] + row
                    interfaces.append(Interface(fraction, outer, inner, "boundary", number))
        return interfaces

    def compute_refractive_indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return complex refractive indices, shape (wavelengths, materials)."""
        return np.concatenate(
            [layer.compute_refractive_indices(wavelength_nm) for layer in self.scene_layers], axis=1
        )

    def describe(self) -> dict[str, Any]:
        """Return the inputs and derived quantities of all layers as dataset attributes."""
        attrs: dict[str, Any] = {"depth_m": self.depth_m}
        for number, layer in enumerate(self.scene_layers):
            attrs[f"layers_{number}_kind"] = self.layers[number].kind
            layer_attrs = layer.describe()
            layer_attrs.pop("ground", None)
            attrs |= {f"layers_{number}_{key}": value for key, value in layer_attrs.items()}
        return attrs | describe_ground(self.ground)


# --------------------------------------------------------------------------------------------------
# Media whose particles are conservative, in a matrix that absorbs instead.


AbsorptionCoefficient = Annotated[float, Quantity("absorption coefficient of the matrix", "m-1")]


@declare_class
class AbsorbingMatrixLayer(ParticleLayer):
    """Layer of conservative particles in an absorbing matrix.

    Absorption at particles is equivalent to absorption along the path.  With the latter, path
    lengths give the absorption between any two depths.

    Parameters
    ----------
    absorption_per_m : float
        Absorption coefficient of the matrix (1/m).
    """

    absorption_per_m: AbsorptionCoefficient = 0.0

    def compute_added_absorption(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the absorption coefficient of the matrix (1/m), shape (wavelengths, 2)."""
        added = np.zeros((np.size(wavelength_nm), 2))
        added[:, MATRIX] = self.absorption_per_m
        return added


def absorb_along_path(medium: Medium) -> Medium:
    """Return a medium that is equivalent, but whose particles absorb along the path."""
    if isinstance(medium, ParticleLayer):
        albedo = medium.single_scattering_albedo
        inputs: dict[str, Any] = {f.name: getattr(medium, f.name) for f in fields(medium)}
        inputs["optical_thickness"] = albedo * medium.optical_thickness
        inputs["single_scattering_albedo"] = 1.0
        absorption_per_m = (1.0 - albedo) * medium.extinction_per_m
        return AbsorbingMatrixLayer(**inputs, absorption_per_m=absorption_per_m)
    if isinstance(medium, Stack) and not all(layer.has_grains for layer in medium.layers):
        layers = (one if one.has_grains else absorb_along_path(one) for one in medium.layers)
        return Stack(tuple(layers), medium.ground)
    return medium
