"""Description of a layer of small particles for the kernels."""

from __future__ import annotations

from typing import NamedTuple

from splits.kernels.optics.phase_function import PhaseFunction
from splits.kernels.optics.source import Source
from splits.kernels.optics.stokes import Stokes
from splits.kernels.rough_surface.realization import HeightFields

OPEN_BOTTOM = -1.0
"""Bottom albedo of a layer that ends at a smooth interface to the outer medium."""


class ScatteringLayer(NamedTuple):
    """Layer between its mean surface z = 0 and z = −depth.

    Attributes
    ----------
    depth : float
        Depth (m); may be infinite.
    extinction : float
        Extinction coefficient (1/m); infinite for an opaque layer, which only its surface reflects.
    albedo : float
        Single-scattering albedo.
    refractive_index : float
        Refractive index relative to the outer medium.
    bottom_albedo : float
        Albedo of the diffuse bottom, or `OPEN_BOTTOM`.
    analog : bool
        Analog absorption instead of weights.
    """

    depth: float
    extinction: float
    albedo: float
    refractive_index: float
    bottom_albedo: float
    analog: bool


class LayerScene(NamedTuple):
    """Layer with its light source and surface.

    Attributes
    ----------
    source : Source
    layer : ScatteringLayer
    phase : PhaseFunction
    fields : HeightFields or None
        Rough surface, of which every ray has its own realization; None if it is smooth.
    stokes : Stokes or None
        Polarization of the incident light, `UNPOLARIZED`, or None without polarization.
    """

    source: Source
    layer: ScatteringLayer
    phase: PhaseFunction
    fields: HeightFields | None
    stokes: Stokes | None
