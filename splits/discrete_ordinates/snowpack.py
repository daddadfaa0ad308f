"""Spectra of plane snowpacks by discrete ordinates: number of streams, and errors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.resources import as_file, files
from typing import NamedTuple

import numpy as np
import xarray as xr

from splits.discrete_ordinates.adding import (
    Boundary,
    Budget,
    Element,
    compute_budget,
    make_isotropic,
)
from splits.discrete_ordinates.grain_table import GrainTable
from splits.discrete_ordinates.pores import (
    RefractingCells,
    make_wet_boundary,
    make_wet_interface,
    refract_directions,
)
from splits.discrete_ordinates.slab import solve_slab
from splits.discrete_ordinates.snow_layers import MIN_SATURATION, SnowLayer
from splits.discrete_ordinates.streams import Streams

STREAM_NUMBERS = (8, 12, 16, 24, 32, 48, 64)
"""Numbers of streams to choose from."""
N_TRIAL_WAVELENGTHS = 16
"""Number of wavelengths at which the truncation error is measured, with twice the streams."""
WET_ERROR = 5e-4
"""Error of the balance between dry and wet pores, for any saturation above 0."""


class Snowpack(NamedTuple):
    """Layers of natural snow over a ground, at several wavelengths.

    Attributes
    ----------
    layers : sequence of SnowLayer
        Top first.
    ground : float, shape (wavelengths,)
        Albedo of the ground, 0 for an open lower boundary.
    """

    layers: Sequence[SnowLayer]
    ground: np.ndarray

    @property
    def is_wet(self) -> bool:
        """Whether any layer holds water."""
        return any(np.any(layer.saturation > 0.0) for layer in self.layers)

    def select(self, wavelengths: np.ndarray) -> Snowpack:
        """Return the snowpack at some of its wavelengths."""
        layers = [
            layer._replace(
                contrast=layer.contrast[wavelengths],
                water_index=layer.water_index[wavelengths],
                grain_absorption=layer.grain_absorption[..., wavelengths],
                pore_absorption=layer.pore_absorption[..., wavelengths, :],
            )
            for layer in self.layers
        ]
        return Snowpack(layers, self.ground[..., wavelengths])

    def solve(self, cosines: np.ndarray, n_streams: int) -> Budget:
        """Return the budget of light for beams, and for diffuse light (last).

        Parameters
        ----------
        cosines : float, shape (beams,)
        n_streams : int
            Even number of streams in both hemispheres.
        """
        streams = Streams.from_number(n_streams)
        table = load_natural_grains(wet=self.is_wet)
        optics = [layer.compute_optics(table, n_streams + 1) for layer in self.layers]
        directions = cosines[np.newaxis]
        if self.is_wet:
            directions = refract_directions(cosines, self.layers[0].water_index)
        isotropic = [make_isotropic(one, streams, cosines.size) for one in optics]
        elements = [
            Element.from_slab(solve_slab(one.truncate(n_streams), streams, directions), vector)
            for one, vector in zip(optics, isotropic, strict=True)
        ]
        ends = isotropic[0], isotropic[-1]
        if not self.is_wet:
            faces = (Boundary.make_transparent(n_streams // 2, cosines.size),) * 2
            return compute_budget(elements, ends, faces, self.ground, n_streams // 2)
        elements, faces = self._add_faces(elements, streams, cosines)
        return compute_budget(elements, ends, faces, self.ground, n_streams)

    def _add_faces(
        self, layers: list[Element], streams: Streams, cosines: np.ndarray
    ) -> tuple[list[Element], tuple[Boundary, Boundary]]:
        """Return the layers with the interfaces between them, and both boundaries."""
        index = self.layers[0].water_index
        cells = RefractingCells.from_index(index, streams)
        saturations = [max(float(one.saturation), MIN_SATURATION) for one in self.layers]
        elements = layers[:1]
        for upper, lower, layer in zip(saturations, saturations[1:], layers[1:], strict=False):
            if upper != lower:
                elements.append(make_wet_interface((upper, lower), index, cells, cosines))
            elements.append(layer)
        top, bottom = (
            make_wet_boundary(saturation, index, cells, cosines)
            for saturation in (saturations[0], saturations[-1])
        )
        return elements, (top, bottom)


class SpectrumSolution(NamedTuple):
    """Budget of light with its errors.

    Attributes
    ----------
    budget : Budget
    n_streams : int
    truncation : float, shape (wavelengths,)
        Error due to the number of streams.
    optics_error : float, shape (wavelengths,)
        Error due to the tables of single scattering, and to the balance of wet and dry pores.
    """

    budget: Budget
    n_streams: int
    truncation: np.ndarray
    optics_error: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """Error of reflectance and transmittance, shape (wavelengths,)."""
        error: np.ndarray = np.hypot(self.truncation, self.optics_error)
        return error


def solve_spectrum(snowpack: Snowpack, cosines: np.ndarray, max_error: float) -> SpectrumSolution:
    """Return the budget of light by as many streams as an error requires.

    Parameters
    ----------
    snowpack : Snowpack
    cosines : float, shape (beams,)
    max_error : float
        The number of streams is the first whose truncation error is at most half of this.
    """
    trial = select_trials(snowpack.ground.size)
    few = snowpack.select(trial)
    for n_streams in STREAM_NUMBERS:
        coarse, fine = (few.solve(cosines, number) for number in (n_streams, 2 * n_streams))
        difference = np.maximum(
            np.abs(coarse.reflectance - fine.reflectance),
            np.abs(coarse.transmittance - fine.transmittance),
        ).max(axis=-1)
        if difference.max() <= 0.5 * max_error:
            break
    return SpectrumSolution(
        snowpack.solve(cosines, n_streams), n_streams, spread_trials(difference, trial),
        compute_optics_error(snowpack),
    )  # fmt: skip


def select_trials(n_wavelengths: int) -> np.ndarray:
    """Return the numbers of the wavelengths at which truncation errors are measured."""
    count = min(N_TRIAL_WAVELENGTHS, n_wavelengths)
    return np.unique(np.linspace(0, n_wavelengths - 1, count).round().astype(int))


def spread_trials(difference: np.ndarray, trial: np.ndarray) -> np.ndarray:
    """Return errors at all wavelengths: between two trial wavelengths, the larger one of both."""
    position = np.searchsorted(trial, np.arange(trial[-1] + 1))
    before = np.maximum(position - 1, 0)
    spread: np.ndarray = np.maximum(difference[..., position], difference[..., before])
    return spread


def compute_optics_error(snowpack: Snowpack) -> np.ndarray:
    """Return the error of the tables of single scattering, shape (..., wavelengths)."""
    table = load_natural_grains(wet=snowpack.is_wet)
    errors = [
        table.interpolate_stderr(layer.contrast, layer.grain_absorption)
        for layer in snowpack.layers
    ]
    return np.hypot(np.max(errors, axis=0), WET_ERROR if snowpack.is_wet else 0.0)


@cache
def load_natural_grains(wet: bool) -> GrainTable:
    """Return the table of the grains of natural snow, dry or wet."""
    name = "natural_grains_wet.nc" if wet else "natural_grains_dry.nc"
    with as_file(files("splits.discrete_ordinates") / name) as path:
        return GrainTable.from_dataset(xr.load_dataset(path))
