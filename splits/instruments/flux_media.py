"""Media as profiles trace them: with an end, and with absorption along paths.

A medium without end is traced to a cut, below which diffusion theory stands for the rest
(`splits.simulation.deep_medium`).  Paths serve each wavelength twice there: with what the rest
keeps by theory, and with as much more as theory may be off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from splits.core.validation import invalid
from splits.instruments.flux_errors import compute_absorption_steps
from splits.kernels.grains.scene import WET_PORE
from splits.media.ground import BLACK_OPTICAL_DEPTH, Ground
from splits.media.medium import GranularMedium, LayeredMedium
from splits.media.particle_layer import (
    CLEARANCE_SIGMA,
    SEMI_INFINITE_TRANSPORT_MFP,
    ParticleLayer,
)
from splits.media.stack import Stack
from splits.media.stacked_particle_layer import (
    UNSUPPORTED_IN_STACK,
    AbsorbingMatrixLayer,
    StackedParticleLayer,
)
from splits.simulation.deep_medium import truncate_deep_medium
from splits.simulation.path_tally import PathSharingMedia
from splits.simulation.scene import (
    OpticalConstants,
    compute_optical_constants,
    get_reflecting_ground,
    make_height_fields,
)
from splits.simulation.truncated_medium import THEORY_UNCERTAINTY

_MATRIX_GAP_FRACTION = 1e-6
"""Thickness, in units of its layer's, of the matrix between a layer's end and its bottom."""
_MAX_OPTICAL_DISTANCE = 5e5
"""Optical thickness from which on hardly anything is absorbed that far from light, or ever."""


class TracedMedium(NamedTuple):
    """A medium as it is traced.

    Attributes
    ----------
    medium : GranularMedium or LayeredMedium
    constants : OpticalConstants
        Of each wavelength; where there is a cut, then of each with more kept below.
    n_wavelengths : int
    planes_m : float, shape (planes,)
        Top, depths asked for, and bottom or the end of tracing.
    semi_infinite : bool
        Whether the medium goes on below that.
    truncated : bool
        Whether diffusion theory stands for what is below.
    material_columns : dict of str to int
        Columns of the materials, by name.
    """

    medium: GranularMedium | LayeredMedium
    constants: OpticalConstants
    n_wavelengths: int
    planes_m: np.ndarray
    semi_infinite: bool
    truncated: bool
    material_columns: dict[str, int]

    @property
    def edges_m(self) -> np.ndarray:
        """Depths between which intervals lie (m)."""
        return np.append(self.planes_m[:-1], np.inf) if self.semi_infinite else self.planes_m

    def is_absorbing(self) -> np.ndarray:
        """Tell at which wavelengths the lowest layer absorbs, shape (wavelengths,)."""
        absorption = self.constants.absorption[: self.n_wavelengths]
        lowest = self.planes_m[-1] * np.array([1.0 - 1e-6, 1.0])
        absorbing: np.ndarray = (
            compute_absorption_steps(self.medium, absorption, lowest).absorption_rate[0] > 0.0
        )
        return absorbing


@dataclass(frozen=True)
class _AbsorbingStack(Stack):
    """A stack whose particles absorb along the path."""

    @cached_property
    def scene_layers(self) -> tuple[Any, ...]:
        """The layers as scenes take them."""
        return tuple(
            AbsorbingMatrixLayer.from_particle_layer(part)
            if isinstance(part, StackedParticleLayer)
            else part
            for part in super().scene_layers
        )


@dataclass(frozen=True)
class _ParticleSlab(_AbsorbingStack):
    """A layer of particles alone, whose bottom touches the matrix."""

    @cached_property
    def scene_layers(self) -> tuple[Any, ...]:
        """The layer, and below it what has the matrix' index outside, where it has a bottom."""
        (part,) = super().scene_layers
        if self.ground is None:
            return (part,)
        n = part.layer.refractive_index
        clear = ParticleLayer(0.0, 1.0, 0.0, n, None, depth_m=_MATRIX_GAP_FRACTION * part.depth_m)
        return part, AbsorbingMatrixLayer(clear, outer_index=n)


def get_thickness(medium: Any) -> float:
    """Return the thickness of a medium (m), which may have no end."""
    endless = isinstance(medium, ParticleLayer) and math.isinf(medium.optical_thickness)
    return math.inf if endless else float(medium.depth_m)


def prepare_medium(
    medium: Any,
    wavelengths: np.ndarray,
    depths_m: Sequence[float],
    max_stderr: float,
    seed: int,
    threads: int,
) -> TracedMedium:
    """Return a medium as it is traced for light at depths.

    Parameters
    ----------
    medium : GranularMedium, LayeredMedium or ParticleLayer
    wavelengths : float, shape (wavelengths,)
        nm.
    depths_m : sequence of float
        In the medium (m).
    max_stderr, seed, threads
        As for the spectrophotometer.
    """
    rough = (
        medium.make_height_fields()
        if isinstance(medium, ParticleLayer)
        else make_height_fields(medium)
    )
    if rough is not None:
        least = CLEARANCE_SIGMA * float(np.linalg.norm(rough.rms_height))
        if depths_m[0] < least:
            hint = f"{CLEARANCE_SIGMA:g} standard deviations of the surface's height"
            raise invalid("depth_m", float(depths_m[0]), f"at least {least:g} m", hint)
    if isinstance(medium, ParticleLayer):
        return _prepare_particle_layer(medium, wavelengths, depths_m)
    endless = math.isinf(get_thickness(medium))
    whole = medium
    if endless:
        above = float(sum(part.depth_m for part in getattr(medium, "scene_layers", ())[:-1]))
        family, within = PathSharingMedia.from_media([medium]), max(0.0, depths_m[-1] - above)
        cut: Any = truncate_deep_medium(family, wavelengths, max_stderr, seed, threads, within)
        whole = cut.media[0]
    if any(isinstance(part, StackedParticleLayer) for part in getattr(whole, "scene_layers", ())):
        whole = _AbsorbingStack(whole.layers, whole.ground)
    names = {name: column for column, name in enumerate(medium.list_materials())}
    return _prepare_finite_medium(
        whole, wavelengths, depths_m, float(whole.depth_m), endless, names
    )


def _prepare_finite_medium(
    medium: Any,
    wavelengths: np.ndarray,
    depths_m: Sequence[float],
    end_m: float,
    semi_infinite: bool,
    material_columns: dict[str, int],
) -> TracedMedium:
    """Return a medium that ends as it is traced."""
    constants = compute_optical_constants(medium, wavelengths)
    # A ground below what has no end is one that stands for the rest.
    cut = (
        semi_infinite
        and not isinstance(medium, _ParticleSlab)
        and get_reflecting_ground(medium) is not None
    )
    if cut:
        constants = _append_darker_ground(constants)
    planes = np.array([0.0, *depths_m, end_m])
    return TracedMedium(
        medium, constants, wavelengths.size, planes, semi_infinite, cut, material_columns
    )


def _append_darker_ground(constants: OpticalConstants) -> OpticalConstants:
    """Return constants twice, the second time over a ground that keeps more by `THEORY_UNCERTAINTY`."""
    more = constants.absorption.copy()
    kept = -(1.0 + THEORY_UNCERTAINTY) * np.expm1(-more[:, -1])
    more[:, -1] = -np.log(np.maximum(1.0 - kept, math.exp(-700.0)))
    more[:, -1] = np.where(kept < 1.0, more[:, -1], BLACK_OPTICAL_DEPTH)
    return OpticalConstants(
        np.concatenate([constants.indices, constants.indices]),
        np.concatenate([constants.absorption, more]),
    )


def _prepare_particle_layer(
    layer: ParticleLayer, wavelengths: np.ndarray, depths_m: Sequence[float]
) -> TracedMedium:
    """Return a layer of particles alone as it is traced."""
    for name in ("polarized", "opaque"):
        if getattr(layer, name):
            hint = (
                "profiles know no polarization"
                if name == "polarized"
                else UNSUPPORTED_IN_STACK[name][1]
            )
            raise invalid(name, True, "false", hint)
    endless = math.isinf(layer.optical_thickness)
    ground: Ground | None = Ground.from_input(layer.bottom_albedo)
    bare = replace(layer, bottom_albedo=None)
    if endless:
        end = depths_m[-1] + _compute_truncation_distance(layer)
        thickness = layer.extinction_per_m * end
        bare = replace(bare, optical_thickness=thickness, depth_m=end)
        ground = Ground.from_input(1.0)
    slab = _ParticleSlab((bare,), ground)
    names = {"matrix": WET_PORE}
    return _prepare_finite_medium(slab, wavelengths, depths_m, float(bare.depth_m), endless, names)


def _compute_truncation_distance(layer: ParticleLayer) -> float:
    """Return below which distance from light (m) the end of a layer does not show."""
    albedo, g = layer.single_scattering_albedo, layer.kernel_phase_function.g
    rate = min(1.0, math.sqrt(3.0 * (1.0 - albedo) * (1.0 - albedo * g)))
    # Over a white bottom: at its distance z from light it shows by exp(-2 rate z) and no more.
    far = SEMI_INFINITE_TRANSPORT_MFP * max(1.0, 1.0 / (1.0 - g))
    if rate > 0.0:
        far = max(far, min(0.5 * SEMI_INFINITE_TRANSPORT_MFP / rate, _MAX_OPTICAL_DISTANCE))
    return far / layer.extinction_per_m
