"""A layer of small particles, as kernels take it."""

from __future__ import annotations

from typing import NamedTuple

from splits.kernels.optics.phase_function import PhaseFunction
from splits.kernels.optics.source import Source
from splits.kernels.optics.stokes import Stokes
from splits.kernels.rough_surface.realization import HeightFields

OPEN_BOTTOM = -1.0
"""In place of the bottom's albedo: the layer ends at a smooth face to the outer medium."""


class ScatteringLayer(NamedTuple):
    """The layer between its mean surface z = 0 and z = −depth.

    Attributes
    ----------
    depth : float
        Metres; may be infinite.
    extinction : float
        1/m; infinite where nothing comes back from below the surface.
    albedo : float
        Of single scattering.
    refractive_index : float
        Refractive index relative to the outer medium.
    bottom_albedo : float
        Albedo of the diffuse bottom, or `OPEN_BOTTOM`.
    analog : bool
        Absorption by coin toss.
    """

    depth: float
    extinction: float
    albedo: float
    refractive_index: float
    bottom_albedo: float
    analog: bool


class LayerScene(NamedTuple):
    """What there is.

    Attributes
    ----------
    source : Source
    layer : ScatteringLayer
    phase : PhaseFunction
    fields : HeightFields or None
        The rough surface; every ray meets a realisation of its own.
    stokes : Stokes or None
        Polarization of the light as it comes, `NATURAL`, or None where nobody asks for it.
    """

    source: Source
    layer: ScatteringLayer
    phase: PhaseFunction
    fields: HeightFields | None
    stokes: Stokes | None
