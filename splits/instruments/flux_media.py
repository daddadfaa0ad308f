"""Media in the form in which fluxes are traced: of finite depth, and with absorption along paths.

A semi-infinite medium is traced to a truncation depth, below which diffusion theory replaces the
rest (`splits.simulation.deep_medium`).  Each wavelength is then estimated twice: with the
absorptance of the rest from theory, and with a larger one by the uncertainty of the theory.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from splits.core.validation import invalid
from splits.instruments.absorption_steps import compute_absorption_steps
from splits.kernels.grains.scene import WET_PORE
from splits.media.absorbing_matrix_layer import AbsorbingMatrixLayer
from splits.media.ground import BLACK_OPTICAL_DEPTH
from splits.media.medium import GranularMedium, LayeredMedium
from splits.media.particle_layer import (
    CLEARANCE_SIGMA,
    SEMI_INFINITE_TRANSPORT_MFP,
    ParticleLayer,
)
from splits.media.stack import UNSUPPORTED_IN_STACK, Stack
from splits.simulation.deep_medium import truncate_deep_medium
from splits.simulation.path_tally import PathSharingMedia
from splits.simulation.scene import (
    OpticalConstants,
    compute_optical_constants,
    get_reflecting_ground,
    make_height_fields,
)
from splits.simulation.truncated_medium import THEORY_UNCERTAINTY

_MAX_OPTICAL_DISTANCE = 5e5
"""Optical thickness above which absorption at that distance from the light is negligible."""


class TracedMedium(NamedTuple):
    """A medium in the form in which it is traced.

    Attributes
    ----------
    medium : GranularMedium, LayeredMedium or ParticleLayer
    constants : OpticalConstants
        For each wavelength; with truncation, then for each with a more absorbing substrate.
    n_wavelengths : int
    planes_m : float, shape (planes,)
        Top, requested depths, and bottom or the end of tracing.
    semi_infinite : bool
        Whether the medium continues below that.
    truncated : bool
        Whether diffusion theory replaces the part below.
    material_columns : dict of str to int
        Columns of the materials, by name.
    """

    medium: GranularMedium | LayeredMedium | ParticleLayer
    constants: OpticalConstants
    n_wavelengths: int
    planes_m: np.ndarray
    semi_infinite: bool
    truncated: bool
    material_columns: dict[str, int]

    @property
    def edges_m(self) -> np.ndarray:
        """Edges of the intervals (m)."""
        return np.append(self.planes_m[:-1], np.inf) if self.semi_infinite else self.planes_m

    def is_absorbing(self) -> np.ndarray:
        """Return at which wavelengths the lowest layer absorbs, shape (wavelengths,)."""
        absorption = self.constants.absorption[: self.n_wavelengths]
        lowest_interval = self.planes_m[-1] * np.array([1.0 - 1e-6, 1.0])
        absorbing: np.ndarray = (
            compute_absorption_steps(self.medium, absorption, lowest_interval).absorption_rate[0]
            > 0.0
        )
        return absorbing


@dataclass(frozen=True)
class _AbsorbingStack(Stack):
    """Stack whose particles absorb along the path."""

    @cached_property
    def scene_layers(self) -> tuple[Any, ...]:  # type: ignore[override]
        """The layers in the form of scenes."""
        return tuple(
            AbsorbingMatrixLayer.from_particle_layer(layer)
            if isinstance(layer, ParticleLayer)
            else layer
            for layer in self.layers
        )


def get_thickness(medium: Any) -> float:
    """Return the thickness of a medium (m), which may be infinite."""
    semi_infinite = isinstance(medium, ParticleLayer) and math.isinf(medium.optical_thickness)
    return math.inf if semi_infinite else float(medium.depth_m)


def prepare_medium(
    medium: Any,
    wavelengths: np.ndarray,
    depths_m: Sequence[float],
    max_stderr: float,
    seed: int,
    threads: int,
) -> TracedMedium:
    """Return a medium in the form in which it is traced for fluxes at depths.

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
    height_fields = make_height_fields(medium)
    if height_fields is not None:
        min_depth = CLEARANCE_SIGMA * float(np.linalg.norm(height_fields.rms_height))
        if depths_m[0] < min_depth:
            hint = f"{CLEARANCE_SIGMA:g} standard deviations of the surface's height"
            raise invalid("depth_m", float(depths_m[0]), f"at least {min_depth:g} m", hint)
    if isinstance(medium, ParticleLayer):
        return _prepare_particle_layer(medium, wavelengths, depths_m)
    semi_infinite = math.isinf(get_thickness(medium))
    traced = medium
    if semi_infinite:
        depth_above = float(
            sum(layer.depth_m for layer in getattr(medium, "scene_layers", ())[:-1])
        )
        path_sharing, undisturbed_depth = (
            PathSharingMedia.from_media([medium]),
            max(0.0, depths_m[-1] - depth_above),
        )
        truncation: Any = truncate_deep_medium(
            path_sharing, wavelengths, max_stderr, seed, threads, undisturbed_depth
        )
        traced = truncation.media[0]
    if any(isinstance(layer, ParticleLayer) for layer in getattr(traced, "scene_layers", ())):
        traced = _AbsorbingStack(traced.layers, traced.ground)
    columns = {name: column for column, name in enumerate(medium.list_materials())}
    return _prepare_finite_medium(
        traced, wavelengths, depths_m, float(traced.depth_m), semi_infinite, columns
    )


def _prepare_finite_medium(
    medium: Any,
    wavelengths: np.ndarray,
    depths_m: Sequence[float],
    end_m: float,
    semi_infinite: bool,
    material_columns: dict[str, int],
) -> TracedMedium:
    """Return a finite medium in the form in which it is traced."""
    constants = compute_optical_constants(medium, wavelengths)
    # A ground of a semi-infinite medium is the one that replaces the rest.
    truncated = (
        semi_infinite
        and not isinstance(medium, ParticleLayer)
        and get_reflecting_ground(medium) is not None
    )
    if truncated:
        constants = _append_darker_ground(constants)
    planes = np.array([0.0, *depths_m, end_m])
    return TracedMedium(
        medium, constants, wavelengths.size, planes, semi_infinite, truncated, material_columns
    )


def _append_darker_ground(constants: OpticalConstants) -> OpticalConstants:
    """Return the constants and those with a substrate more absorbing by `THEORY_UNCERTAINTY`."""
    absorption = constants.absorption.copy()
    absorbed = -(1.0 + THEORY_UNCERTAINTY) * np.expm1(-absorption[:, -1])
    absorption[:, -1] = -np.log(np.maximum(1.0 - absorbed, math.exp(-700.0)))
    absorption[:, -1] = np.where(absorbed < 1.0, absorption[:, -1], BLACK_OPTICAL_DEPTH)
    return OpticalConstants(
        np.concatenate([constants.indices, constants.indices]),
        np.concatenate([constants.absorption, absorption]),
    )


def _prepare_particle_layer(
    layer: ParticleLayer, wavelengths: np.ndarray, depths_m: Sequence[float]
) -> TracedMedium:
    """Return a single layer of particles in the form in which it is traced."""
    if layer.opaque:
        raise invalid("opaque", True, "false", UNSUPPORTED_IN_STACK["opaque"][1])
    semi_infinite = math.isinf(layer.optical_thickness)
    if semi_infinite:
        end_m = depths_m[-1] + _compute_truncation_distance(layer)
        thickness = layer.extinction_per_m * end_m
        layer = replace(layer, optical_thickness=thickness, depth_m=end_m, bottom_albedo=1.0)
    traced = AbsorbingMatrixLayer.from_particle_layer(layer)
    names = {"matrix": WET_PORE}
    return _prepare_finite_medium(
        traced, wavelengths, depths_m, float(layer.depth_m), semi_infinite, names
    )


def _compute_truncation_distance(layer: ParticleLayer) -> float:
    """Return the distance from the light (m) at which the end of a layer has no effect."""
    albedo, g = layer.single_scattering_albedo, layer.kernel_phase_function.g
    rate = min(1.0, math.sqrt(3.0 * (1.0 - albedo) * (1.0 - albedo * g)))
    # The effect of a white bottom at a distance z from the light is at most exp(-2 rate z).
    optical_distance = SEMI_INFINITE_TRANSPORT_MFP * max(1.0, 1.0 / (1.0 - g))
    if rate > 0.0:
        optical_distance = max(
            optical_distance, min(0.5 * SEMI_INFINITE_TRANSPORT_MFP / rate, _MAX_OPTICAL_DISTANCE)
        )
    return optical_distance / layer.extinction_per_m
