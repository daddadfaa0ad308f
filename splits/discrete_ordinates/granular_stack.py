"""Spectra of plane layers by discrete ordinates: number of streams, and errors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.resources import as_file, files
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.discrete_ordinates.adding import (
    Boundary,
    Budget,
    Element,
    compute_budget,
    make_faces,
    make_isotropic,
    refract_directions,
)
from splits.discrete_ordinates.grains import GrainTable
from splits.discrete_ordinates.granular_layers import (
    MIN_WET_FRACTION,
    GranularLayer,
    compute_replicate_error,
    join_layers,
    list_traced,
)
from splits.discrete_ordinates.homogeneous_layer import (
    TINY,
    LayerOptics,
    Streams,
    solve_slab,
)

STREAM_NUMBERS = (8, 12, 16, 24, 32, 48, 64)
"""Numbers of streams to choose from."""
N_TRIAL_WAVELENGTHS = 16
"""Number of wavelengths at which the truncation error is measured, with twice the streams."""
WET_ERROR = 5e-4
"""Error of the balance between dry and wet pores, for any saturation above 0."""


MAX_SLAB_VALUES = 2**16
"""Largest size of a matrix of all layers and wavelengths that are solved at once."""
MAX_JOINED_ROWS = 512
"""Number of snowpacks times wavelengths above which a common solution saves no time."""


CUTOFF_SHARE = 0.01
"""Light that may be missing in a reflectance, see `GranularStack`, over the requested error."""
GRAINS, AIR, REVERSED = "grains", "air", "reversed"
GRAZING_COSINE = 0.035
"""Cosine of a beam below which the change by more streams oscillates with the angle."""
NEIGHBOUR_FACTORS = (2.0, 4.0)
"""Cosines of the beams beside a grazing one, relative to its own, whose changes are as large."""


class StackElements(NamedTuple):
    """Layers and interfaces of a snowpack, for a number of streams.

    Attributes
    ----------
    elements : sequence of Element
        Top first.
    isotropic : sequence of arrays, shape (..., radiances)
        Isotropic radiance above each element, and below the last one.
    boundaries : (Boundary, Boundary)
    ground : float, shape (wavelengths,)
    n_streams : int
        Number of the streams of all states in one hemisphere.
    optics : LayerOptics
        Of the layers, along the first dimension, before truncation.
    seen : sequence, optional
        Positions of the snowpacks and wavelengths that each element has; by default all.
    """

    elements: Sequence[Element]
    isotropic: Sequence[np.ndarray]
    boundaries: tuple[Boundary, Boundary]
    ground: np.ndarray
    n_streams: int
    optics: LayerOptics
    seen: Sequence[Any] | None = None

    def compute_budget(self, *, with_absorption: bool = False) -> Budget:
        """Return the budget of light for the beams, and for diffuse light (last)."""
        return compute_budget(
            self.elements, (self.isotropic[0], self.isotropic[-1]), self.boundaries, self.ground,
            self.n_streams, with_absorption=with_absorption, seen=self.seen,
        )  # fmt: skip


class GranularStack(NamedTuple):
    """Layers of grains over a ground, at several wavelengths.

    Dry snowpacks of natural snow of the same number of layers may be along a leading dimension.

    Attributes
    ----------
    layers : sequence of GranularLayer
        Top first.
    ground : float, shape (..., wavelengths)
        Albedo of the ground, 0 for an open lower boundary.
    equilibrium : {"grains", "air", "reversed"}
        Of wet and dry pores: that of the grains, which is not reciprocal at the boundaries; that of
        air in all layers; or that of the grains for light that is traced backwards, so that the
        reflectance of a beam is the radiance in its direction under diffuse light.
    cutoff : float
        Part of the incident light that may be missing in the reflectance, so that layers from which
        less returns are left out at each wavelength (`find_seen_layers`).  There is then no
        transmittance.
    """

    layers: Sequence[GranularLayer]
    ground: np.ndarray
    equilibrium: str = GRAINS
    cutoff: float = 0.0

    @property
    def is_wet(self) -> bool:
        """Whether light is in wet and in dry pores, as any layer holds water."""
        return any(layer.grains.n_states > 1 for layer in self.layers)

    @property
    def water_index(self) -> np.ndarray | None:
        """Refractive index of water, shape (wavelengths,); None if all layers are dry."""
        return self.layers[0].water_index if self.is_wet else None

    @property
    def wet_fractions(self) -> list[float]:
        """Fractions of wet pores, above 0; none if all layers are dry."""
        fractions = (layer.wet_fraction for layer in self.layers if self.is_wet)
        return [max(float(one), MIN_WET_FRACTION) for one in fractions]

    def select(self, wavelengths: Any, snowpacks: Any = ...) -> GranularStack:
        """Return the snowpack at some of its wavelengths, or some snowpacks of several."""
        layers = [layer.select(snowpacks, wavelengths) for layer in self.layers]
        return self._replace(layers=layers, ground=self.ground[snowpacks][..., wavelengths])

    @classmethod
    def join(cls, snowpacks: Sequence[GranularStack]) -> GranularStack:
        """Return dry snowpacks of the same materials along a leading dimension."""
        layers = [
            join_layers(parts) for parts in zip(*(one.layers for one in snowpacks), strict=True)
        ]
        return snowpacks[0]._replace(
            layers=layers, ground=np.stack([one.ground for one in snowpacks])
        )

    def compute_optics(self, orders: int) -> LayerOptics:
        """Return `GranularLayer.compute_optics` of all layers, along the first dimension."""
        table, contrast = self.layers[0].grains, self.layers[0].contrast
        is_table = isinstance(table, GrainTable) and not self.is_wet
        if is_table and all(
            one.grains is table and np.array_equal(one.contrast, contrast) for one in self.layers
        ):
            return join_layers(self.layers).compute_optics(orders)
        optics = [layer.compute_optics(orders, self.equilibrium == AIR) for layer in self.layers]
        return LayerOptics(*(np.stack(values) for values in zip(*optics, strict=True)))

    def divide(self, edges_m: np.ndarray) -> tuple[GranularStack, np.ndarray]:
        """Return the snowpack with its layers divided at depths, and the layer of each part.

        Parameters
        ----------
        edges_m : float, shape (edges,)
            Increasing depths (m), with all boundaries between layers except the last one.

        Returns
        -------
        GranularStack, int (parts,)
        """
        bottoms = np.cumsum([float(layer.depth_m) for layer in self.layers])
        edges = np.append(edges_m, bottoms[-1])
        middle = edges[:-1] + 0.5 * np.minimum(np.diff(edges), 1.0)
        owners = np.searchsorted(bottoms[:-1], middle)
        parts = [
            self.layers[owner]._replace(depth_m=np.asarray(thickness))
            for owner, thickness in zip(owners, np.diff(edges), strict=True)
        ]
        return self._replace(layers=parts), owners

    def build(self, cosines: np.ndarray, n_streams: int) -> StackElements:
        """Return the layers and interfaces for beams and for diffuse light.

        Parameters
        ----------
        cosines : float, shape (beams,) or (snowpacks, 1, beams)
            Of each snowpack if there are several.
        n_streams : int
            Even number of streams in both hemispheres.
        """
        n_beams = cosines.shape[-1]
        streams = Streams.from_number(n_streams)
        optics = self.compute_optics(n_streams + 1)
        directions = refract_directions(cosines, self.water_index)
        own = isotropic = make_isotropic(optics, streams, n_beams)
        if self.is_wet:
            in_air = np.stack([layer.compute_air_equilibrium() for layer in self.layers])
            isotropic = make_isotropic(optics._replace(equilibrium=in_air), streams, n_beams)
            own = isotropic**2 / own if self.equilibrium == REVERSED else own
        truncated, n_layers = optics.truncate(n_streams), len(self.layers)
        seen = find_seen_layers(truncated, self.cutoff) if self.cutoff else None
        counts = np.full(n_layers, self.ground.size)
        if seen is not None:
            counts = seen.reshape(n_layers, -1).sum(axis=1)
        # Several layers are solved at once, as far as their matrices fit into the cache.
        elements: list[Element] = []
        n_both = streams.cosines.size * (1 + self.is_wet)
        group = (np.cumsum(counts) - 1) // max(1, MAX_SLAB_VALUES // n_both**2)
        for number in np.unique(group):
            chosen = group == number
            part: Any = chosen
            beams, lengths = directions, None
            if seen is not None:
                part = np.nonzero(seen & chosen.reshape(-1, *(1,) * self.ground.ndim))
                lengths = counts[chosen]
                if directions.ndim > 2:
                    shape = (*self.ground.shape, *directions.shape[-2:])
                    beams = np.broadcast_to(directions, shape)[part[1:]]
            slab = solve_slab(LayerOptics(*(one[part] for one in truncated)), streams, beams)
            inside = own[part] if self.is_wet else None
            elements += Element.from_slab(slab, isotropic[part], inside).split(lengths)
        interfaces, boundaries = make_faces(
            n_layers, self.wet_fractions, self.water_index, streams, cosines
        )
        combined, levels = [], []
        places: list[Any] = []
        for number, interface in enumerate([None, *interfaces]):
            if interface is not None:
                combined.append(interface)
                levels.append(isotropic[number - 1])
                places.append(...)
            combined.append(elements[number])
            levels.append(isotropic[number])
            places.append(... if seen is None else np.nonzero(seen[number]))
        levels.append(isotropic[-1])
        return StackElements(
            combined, levels, boundaries, self.ground, n_both, optics,
            None if seen is None else places,
        )  # fmt: skip

    def solve(self, cosines: np.ndarray, n_streams: int) -> Budget:
        """Return the budget of light for beams, and for diffuse light (last); see `build`.

        It is without the absorption of the layers.
        """
        return self.build(cosines, n_streams).compute_budget()


def find_seen_layers(optics: LayerOptics, cutoff: float) -> np.ndarray:
    """Return from which layers more than a part of the incident light may return.

    Diffuse light decreases with depth as exp(−∫ κ dz), with κ = σ √(3 (1 − ω) (1 − ω g)) (Ishimaru
    1978, Wave Propagation and Scattering in Random Media, section 9.1), and returns the same way.

    Parameters
    ----------
    optics : LayerOptics
        Layers along the first dimension.
    cutoff : float

    Returns
    -------
    bool, shape (layers, ...)
        True for the first layer, and for all above one that is seen.
    """
    # Light that a state scatters into any state; the state that absorbs least counts.
    root = np.sqrt(optics.equilibrium)
    by_order = optics.scattering[..., :2] * root[..., np.newaxis, np.newaxis]
    scattered = by_order.sum(axis=-3) / root[..., np.newaxis]
    lost, deflected = np.moveaxis(optics.extinction[..., np.newaxis] - scattered, -1, 0)
    rate = np.sqrt(3.0 * np.maximum(lost * deflected, 0.0)).min(axis=-1)
    depth = np.cumsum(rate * optics.thickness, axis=0)
    seen = np.ones(depth.shape, dtype=bool)
    seen[1:] = 2.0 * depth[:-1] < -np.log(cutoff)
    return seen


def solve_snowpacks(
    snowpacks: Sequence[GranularStack], cosines: np.ndarray, n_streams: int
) -> np.ndarray:
    """Return reflectances and transmittances of snowpacks that differ in values of parameters.

    Dry ones are solved together, as many as there is a gain in time.

    Parameters
    ----------
    snowpacks : sequence of GranularStack
    cosines : float, shape (snowpacks, 1), or (snowpacks, 0) for diffuse light
    n_streams : int

    Returns
    -------
    float, shape (snowpacks, 2, wavelengths)
    """
    size = 1 if snowpacks[0].is_wet else max(1, MAX_JOINED_ROWS // snowpacks[0].ground.size)
    solutions = []
    for start in range(0, len(snowpacks), size):
        part, beams = snowpacks[start : start + size], cosines[start : start + size]
        if len(part) > 1:
            budget = GranularStack.join(part).solve(beams[:, np.newaxis], n_streams)
        else:
            budget = part[0].solve(beams[0], n_streams)
        values = np.stack([budget.reflectance[..., 0], budget.transmittance[..., 0]], axis=-2)
        solutions.append(values.reshape(len(part), *values.shape[-2:]))
    return np.concatenate(solutions)


def measure_truncation(
    snowpack: GranularStack, cosines: np.ndarray, n_streams: int
) -> tuple[np.ndarray, Budget, Budget]:
    """Return the change of a budget of light by twice as many streams.

    It is that for the beams of `GranularStack.build`, and beside grazing ones.

    Returns
    -------
    largest : float, shape (..., wavelengths)
        Largest change of reflectance, transmittance and their sum.
    coarse, fine : Budget
        With the number of streams, and with twice as many.
    """
    beams = add_neighbours(cosines)
    coarse, fine = (snowpack.solve(beams, number) for number in (n_streams, 2 * n_streams))
    reflected, transmitted = (
        getattr(coarse, name) - getattr(fine, name) for name in ("reflectance", "transmittance")
    )
    changes = np.abs([reflected, transmitted, reflected + transmitted])
    return changes.max(axis=(0, -1)), coarse, fine


def add_neighbours(cosines: np.ndarray) -> np.ndarray:
    """Return the cosines of beams, and of others beside those that graze the surface.

    The change by more streams of a grazing beam may be small by chance, where it changes its sign;
    it is then large at other angles.

    Parameters
    ----------
    cosines : float, shape (..., beams)
    """
    is_grazing = cosines < GRAZING_COSINE
    if not is_grazing.any():
        return cosines
    neighbours = (np.where(is_grazing, factor * cosines, cosines) for factor in NEIGHBOUR_FACTORS)
    return np.concatenate([cosines, *neighbours], axis=-1)


class SpectrumSolution(NamedTuple):
    """Budget of light with its errors.

    Attributes
    ----------
    budget : Budget
    n_streams : int
    truncation : float, shape (wavelengths,)
        Error due to the number of streams.
    optics_error : float, shape (wavelengths,)
        Error due to single scattering, to the extent of grains, and to the balance of wet and dry
        pores.
    trial : (Budget, Budget)
        At the wavelengths of `choose_trial_wavelengths`, see `measure_truncation`.
    exponent_error : float, shape (wavelengths,)
        Error of the logarithm of a transmittance T relative to 1 + |ln T|; infinite if the other
        errors are sufficient (`solve_with_exponent_error`).
    """

    budget: Budget
    n_streams: int
    truncation: np.ndarray
    optics_error: np.ndarray
    trial: tuple[Budget, Budget]
    exponent_error: np.ndarray | float = np.inf

    @property
    def error(self) -> np.ndarray:
        """Error of reflectance and transmittance, shape (wavelengths,)."""
        return np.hypot(self.truncation, self.optics_error)

    def bound_errors(self, values: np.ndarray) -> np.ndarray:
        """Return the errors of reflectance, transmittance, and further quantities up to 1.

        Parameters
        ----------
        values : float, shape (quantities, wavelengths)
        """
        # A fraction cannot be wrong by much more than itself, nor than what is left of the light.
        largest = np.minimum(values, 1.0 - values)
        errors = np.minimum(self.error, np.maximum(largest, np.finfo(float).eps))
        transmittance = np.clip(values[1], np.finfo(float).tiny, 1.0)
        # Errors of thick layers act on the logarithm of the transmittance, which is at most 0.
        logarithm = np.log(transmittance)
        change = np.minimum(
            self.exponent_error * (1.0 - logarithm), np.finfo(float).eps - logarithm
        )
        errors[1] = np.minimum(errors[1], transmittance * np.expm1(change))
        return errors


def solve_spectrum(
    snowpack: GranularStack, cosines: np.ndarray, max_error: float
) -> SpectrumSolution:
    """Return the budget of light by as many streams as an error requires.

    Parameters
    ----------
    snowpack : GranularStack
    cosines : float, shape (beams,)
    max_error : float
        The number of streams is the first whose truncation error is at most half of this.
    """
    trial = choose_trial_wavelengths(snowpack.ground.size)
    few = snowpack.select(trial)
    for n_streams in STREAM_NUMBERS:
        largest, coarse, fine = measure_truncation(few, cosines, n_streams)
        if largest.max() <= 0.5 * max_error:
            break

    def spread(error: np.ndarray) -> np.ndarray:
        return spread_truncation(error, trial, snowpack.ground.size)

    def solve_few(layers: Sequence[GranularLayer]) -> np.ndarray:
        budget = few._replace(layers=layers).solve(cosines, n_streams)
        return np.stack([budget.reflectance, budget.transmittance])

    optics_error = compute_optics_error(snowpack)
    if list_traced(few.layers):
        by_paths = compute_replicate_error(few.layers, solve_few).max(axis=(0, -1))
        optics_error = np.hypot(optics_error, spread(by_paths))
    budget = snowpack.solve(cosines, n_streams)
    slab_error = compute_slab_error(snowpack, budget.reflectance, budget.transmittance)
    return SpectrumSolution(
        budget, n_streams, np.hypot(spread(largest), snowpack.cutoff),
        np.hypot(optics_error, slab_error), (coarse, fine),
    )  # fmt: skip


def choose_trial_wavelengths(n_wavelengths: int) -> np.ndarray:
    """Return the positions of the wavelengths at which the truncation error is measured."""
    count = min(N_TRIAL_WAVELENGTHS, n_wavelengths)
    return np.unique(np.linspace(0, n_wavelengths - 1, count).round().astype(int))


def spread_truncation(difference: np.ndarray, trial: np.ndarray, n_wavelengths: int) -> np.ndarray:
    """Return the truncation error at all wavelengths from that at the trial wavelengths.

    Between two of these the larger error of both applies.
    """
    position = np.searchsorted(trial, np.arange(n_wavelengths))
    before = difference[..., np.maximum(position - 1, 0)]
    return np.maximum(difference[..., position], before)


def compute_optics_error(snowpack: GranularStack) -> np.ndarray:
    """Return the error of single scattering without that of the replicates.

    It combines, for the layer with the largest one, the error of the table of natural snow or the
    bound on interpolation between refractive indices, the bound due to the extent of grains, and
    the balance of wet and dry pores.

    Returns
    -------
    float, shape (..., wavelengths)
    """
    errors = [layer.compute_optics_error() for layer in snowpack.layers]
    return np.hypot(np.max(errors, axis=0), WET_ERROR if snowpack.is_wet else 0.0)


_ERROR_SATURATION, _WEAK_NODE, _ERROR_STREAMS, _STEP = 0.1, 1, 8, 0.01
"""Saturation, node of absorption, streams and relative step of `find_similarity_error`."""


@cache
def load_natural_grains(wet: bool) -> GrainTable:
    """Return the table of the grains of natural snow, dry or wet."""
    name = "natural_grains_wet.nc" if wet else "natural_grains_dry.nc"
    with as_file(files("splits.discrete_ordinates") / name) as path:
        return GrainTable.from_dataset(xr.load_dataset(path))


def find_similarity_error(contrast: np.ndarray, is_wet: bool) -> np.ndarray:
    """Return the relative error of (1 − ω)/(1 − g) in a table, at the next contrasts."""
    table = load_natural_grains(wet=is_wet)
    row = np.searchsorted(table.contrast.nodes, contrast).clip(0, table.contrast.nodes.size - 1)
    return _tabulate_similarity_errors(is_wet)[row]


@cache
def _tabulate_similarity_errors(is_wet: bool) -> np.ndarray:
    """Return these errors at the contrasts of a table, from half-spaces of weak absorption."""
    table = load_natural_grains(wet=is_wet)
    n, q = table.contrast.nodes.size, table.absorption.nodes[_WEAK_NODE]

    def reflect(absorption: float) -> np.ndarray:
        layer = GranularLayer(
            np.asarray(np.inf), np.asarray(1000.0), np.asarray(_ERROR_SATURATION * is_wet),
            table.contrast.nodes, table.water, np.full(n, absorption), np.zeros((n, 2)), table,
        )  # fmt: skip
        return (
            GranularStack([layer], np.zeros(n)).solve(np.array([1.0]), _ERROR_STREAMS).reflectance
        )

    x = q / (1.0 - q)
    slope = np.abs(reflect(x * (1.0 + _STEP)) - reflect(x)).max(axis=-1) / _STEP
    return table.stderr[:, _WEAK_NODE] / slope


def compute_slab_error(
    snowpack: GranularStack, reflectance: np.ndarray, transmittance: np.ndarray
) -> np.ndarray | float:
    """Return the error of reflectance and transmittance of dry natural snow that transmits light.

    The errors of the table are those of half-spaces, which reflect all light without absorption,
    whatever the asymmetry parameter g.  A slab reflects R = s/(s + c) and transmits T = c/(s + c)
    by diffusion theory, where s is proportional to 1 - g: both change by R T times the relative
    error of 1 - g.  The balance of wet and dry pores has a larger error.

    Parameters
    ----------
    snowpack : GranularStack
    reflectance, transmittance : float, shape (..., wavelengths, beams)

    Returns
    -------
    float, shape (..., wavelengths)
        Of the beam for which it is largest; 0 for other grains.
    """
    contrasts = [one.contrast for one in snowpack.layers if isinstance(one.grains, GrainTable)]
    if snowpack.is_wet or not contrasts:
        return 0.0
    change = (reflectance * transmittance).max(axis=-1)
    return change * find_similarity_error(contrasts[0], is_wet=False)


# --------------------------------------------------------------------------------------------------
# Relative errors of small transmittances.
#
# The transmittance T of thick layers is an exponential of their thickness.  The errors of streams
# and of optics therefore change its logarithm, in proportion to 1 + |ln T|, and combine
#
# - truncation, the difference from twice as many streams at some wavelengths;
# - the statistical error of the tables.  Light is attenuated at the rate √(3 (1 − ω) (1 − g)) per
#   mean free path (Ishimaru 1978, Wave Propagation and Scattering in Random Media, section 9.1).
#   The errors of (1 − ω) and (1 − g) are independent, and the relative error of their ratio is
#   known; this rate has half of it;
# - for other grains, the scatter of ln T without each batch of the paths through them, and the
#   bound for grains of finite extent;
# - for wet media, the error of the balance between dry and wet pores.

OPTICS_SHARE = 0.5
"""Error of ln T, relative to 1 + |ln T|, over that of (1 − ω)/(1 − g)."""
BALANCE_ERROR = 1e-3
"""Error of ln T of wet snow, relative to 1 + |ln T|: the largest if light changes 3.5 % more often
between dry and wet pores, half of the difference of both estimates."""
SUFFICIENT_ERROR = 0.01
"""Ratio of the error of a reflectance to a transmittance, below which it is that of both."""


def solve_with_exponent_error(
    snowpack: GranularStack, cosines: np.ndarray, max_error: float
) -> SpectrumSolution:
    """Return the budget of light with the errors of small transmittances; see `solve_spectrum`."""
    solution = solve_spectrum(snowpack, cosines, max_error)
    transmittance = solution.budget.transmittance
    is_small = transmittance * SUFFICIENT_ERROR < solution.error[:, np.newaxis]
    if not (is_small & (transmittance > 0.0)).any():
        return solution
    n_wavelengths = snowpack.ground.size
    trial = choose_trial_wavelengths(n_wavelengths)
    few = snowpack.select(trial)

    def get_logarithm(budget: Budget) -> np.ndarray:
        return np.log(np.maximum(budget.transmittance, TINY))

    def solve(layers: Sequence[GranularLayer]) -> np.ndarray:
        return get_logarithm(few._replace(layers=layers).solve(cosines, solution.n_streams))

    coarse, fine = map(get_logarithm, solution.trial)
    changes = [np.abs(coarse - fine)]
    if list_traced(few.layers):
        changes.append(compute_replicate_error(few.layers, solve))
    relative = [(change / (1.0 + np.abs(fine))).max(axis=-1) for change in changes]
    spread = spread_truncation(np.sqrt(sum(np.square(relative))), trial, n_wavelengths)
    is_wet = snowpack.is_wet
    contrasts = [one.contrast for one in snowpack.layers if isinstance(one.grains, GrainTable)]
    optics = OPTICS_SHARE * find_similarity_error(contrasts[0], is_wet) if contrasts else 0.0
    extent = np.max([layer.compute_extent_bound() for layer in snowpack.layers], axis=0)
    balance = BALANCE_ERROR if is_wet else 0.0
    error = np.sqrt(spread**2 + optics**2 + extent**2 + balance**2)
    return solution._replace(exponent_error=error)
