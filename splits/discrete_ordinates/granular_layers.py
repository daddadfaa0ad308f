"""Layers of grains as arrays, for one snowpack or for many, and their optics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from splits.core.uncertainty import compute_jackknife_stderr
from splits.discrete_ordinates.adding import DRY, WET
from splits.discrete_ordinates.grains import GrainTable, TracedGrains
from splits.discrete_ordinates.homogeneous_layer import TINY, LayerOptics
from splits.kernels.records import N_SCATTERING_BATCHES
from splits.kernels.scene import DRY_PORE, WET_PORE
from splits.simulation.scene import compute_material_constants

# --------------------------------------------------------------------------------------------------
# Phase functions from a limited number of moments: error, and extrapolated forward peak.

N_TAIL_ORDERS = 8
"""Number of the highest orders, which give the error of the phase function."""
N_PEAK_ORDERS, MAX_PEAK_RATIO = 160, 0.97
"""Number of the orders of the forward peak, and largest ratio of two successive moments."""


def estimate_phase_error(
    moments: np.ndarray, cosines: np.ndarray, has_peak: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return ∑ (2l + 1) χ_l P_l without a forward peak, and its error.

    Parameters
    ----------
    moments : float, shape (layers, ..., orders)
        From a limited number of paths.
    cosines : float, shape (..., beams, views, azimuths)
    has_peak : bool
        Whether the last moment is that of a forward peak, which is left out.
    """
    n_orders, tail = moments.shape[-1], slice(-N_TAIL_ORDERS, None)
    factors = 2.0 * np.arange(n_orders) + 1.0
    # Second differences leave the noise of a smooth series; its variance is 6 times as large.
    curvature = np.diff(moments[..., tail], 2)
    noise = (factors[tail][1:-1] * curvature**2).mean(axis=-1) / 6.0
    coefficients = np.moveaxis(moments, -1, 0)[..., np.newaxis, np.newaxis, np.newaxis]
    before, here = np.zeros_like(cosines), np.ones_like(cosines)
    series, peak, power = (np.zeros_like(cosines) for _ in range(3))
    truncated = []
    for order, factor in enumerate(factors):
        if order >= n_orders - N_TAIL_ORDERS:
            truncated.append(series - has_peak * coefficients[order] * peak)
        series = series + factor * coefficients[order] * here
        peak, power = peak + factor * here, power + factor * here**2
        before, here = here, (factor * cosines * here - order * before) / (order + 1.0)
    complete = truncated[-1]
    remainder = np.mean([(complete - one) ** 2 for one in truncated[:-1]], axis=0)
    error = np.sqrt(noise[..., np.newaxis, np.newaxis, np.newaxis] * power + remainder)
    return complete, error


def extend_forward_peak(scattering: np.ndarray) -> np.ndarray:
    """Return scattering (..., 2, 2, orders) with further orders of light that stays in wet pores.

    Grains hardly refract this light, so that its moments decrease slowly.  They continue as a
    geometric series with the mean decrease of the last known orders, and end at 0.
    """
    n_known = scattering.shape[-1]
    own = scattering[..., WET, WET, :]
    last, earlier = (np.maximum(own[..., order], TINY) for order in (-1, -1 - N_TAIL_ORDERS))
    ratio = np.minimum((last / earlier) ** (1.0 / N_TAIL_ORDERS), MAX_PEAK_RATIO)
    extended = np.zeros((*scattering.shape[:-1], N_PEAK_ORDERS))
    extended[..., :n_known] = scattering
    steps = np.arange(1, N_PEAK_ORDERS - n_known + 1)
    # A series that ends with a step oscillates in all directions.
    taper = np.cos(0.5 * np.pi * steps / steps[-1]) ** 2
    tail = last[..., np.newaxis] * ratio[..., np.newaxis] ** steps
    extended[..., WET, WET, n_known:] = tail * taper
    return extended


# --------------------------------------------------------------------------------------------------
# Layers of grains as arrays, for one snowpack or for many, and their optics.

MIN_WET_FRACTION = 1e-9
"""Saturation of a dry layer of a wet snowpack, so that its wet pores have a radiance."""


class GranularLayer(NamedTuple):
    """One layer of each of several snowpacks, at several wavelengths.

    Attributes
    ----------
    depth_m : float, shape (...)
        Thickness (m), 0 for an absent layer.
    collisions_per_m : float, shape (...)
        Collisions with grains per metre of path.
    wet_fraction : float, shape (...)
        Fraction of wet pores.
    contrast : float, shape (wavelengths,)
        Refractive index of the last material of the grains minus 1.
    water_index : float, shape (wavelengths,)
        Refractive index of water.
    grain_absorption : float, shape (..., wavelengths)
        Absorption coefficient of the grains times their mean chord, if they have one material.
    pore_absorption : float, shape (..., wavelengths, 2)
        Absorption coefficient (1/m) of dry and of wet pores, per metre of path between grains.
    grains : GrainTable or TracedGrains
        Single scattering; with two states if any layer of the snowpack is wet.
    extent_error : float
        Bound on the error of fluxes due to the extent of the grains if the layer is thick; 0 for
        point grains.
    """

    depth_m: np.ndarray
    collisions_per_m: np.ndarray
    wet_fraction: np.ndarray
    contrast: np.ndarray
    water_index: np.ndarray
    grain_absorption: np.ndarray
    pore_absorption: np.ndarray
    grains: GrainTable | TracedGrains
    extent_error: float = 0.0

    @classmethod
    def from_medium(
        cls, medium: Any, wavelength_nm: np.ndarray, grains: GrainTable | TracedGrains,
        extent_error: float = 0.0,
    ) -> GranularLayer:  # fmt: skip
        """Return a layer of grains, with their single scattering, at wavelengths (nm)."""
        index, absorption = compute_material_constants(medium, wavelength_nm)
        return cls(
            np.asarray(medium.depth_m),
            np.asarray(medium.extinction_per_m),
            np.asarray(medium.wet_fraction),
            index[:, -1].real - 1.0,
            medium.refractive_index["water"](wavelength_nm).real,
            absorption[:, -1] / medium.attenuation_per_m,
            absorption[:, [DRY_PORE, WET_PORE]],
            grains,
            extent_error,
        )

    def select(self, snowpacks: Any, wavelengths: Any) -> GranularLayer:
        """Return the layer of some snowpacks (`...`: of all), at some of its wavelengths."""
        return GranularLayer(
            self.depth_m[snowpacks],
            self.collisions_per_m[snowpacks],
            self.wet_fraction[snowpacks],
            self.contrast[wavelengths],
            self.water_index[wavelengths],
            self.grain_absorption[snowpacks][..., wavelengths],
            self.pore_absorption[snowpacks][..., wavelengths, :],
            self.grains.select(wavelengths),
            self.extent_error,
        )

    def compute_optics(self, orders: int, in_air: bool = False) -> LayerOptics:
        """Return the optics, per metre, with leading dimensions (..., wavelengths).

        Parameters
        ----------
        orders : int
            Number of Legendre moments, up to `N_PEAK_ORDERS`.  In wet pores, those beyond the table
            are those of its forward peak.
        in_air : bool
            Whether wet and dry pores are in equilibrium with air, so that all is reciprocal,
            instead of the equilibrium of the grains, which differs by a few per cent.
        """
        shape = self.grain_absorption.shape
        collisions, depth = (
            np.broadcast_to(values[..., np.newaxis], shape)
            for values in (self.collisions_per_m, self.depth_m)
        )
        n_states, n_known = self.grains.n_states, self.grains.n_orders
        n_orders = orders if n_states == 1 else min(orders, n_known)
        extinction = collisions[..., np.newaxis] + self.pore_absorption[..., :n_states]
        rate = collisions[..., np.newaxis, np.newaxis, np.newaxis]
        if isinstance(self.grains, TracedGrains):
            # Light advances in grains, too.
            shares = np.stack([1.0 - self.wet_fraction, self.wet_fraction])
            depth = depth * self.grains.compute_packing_ratio(
                self.collisions_per_m + self.pore_absorption @ shares
            )
            moments = self.grains.get_moments(n_orders)
        else:
            saturation = 0.0 if n_states == 1 else float(self.wet_fraction)
            moments = self.grains.compute_moments(
                self.contrast, self.grain_absorption, saturation, n_orders
            )
        if n_states == 1:
            return LayerOptics(depth, extinction, rate * moments, np.ones((*shape, 1)))
        wet_fraction = np.maximum(self.wet_fraction, MIN_WET_FRACTION)[..., np.newaxis]
        ratio = wet_fraction * self.water_index**2 / (1.0 - wet_fraction) if in_air else None
        scattering, equilibrium = _balance_states(moments, wet_fraction, ratio)
        if orders > n_known:
            scattering = extend_forward_peak(scattering)[..., :orders]
        return LayerOptics(depth, extinction, rate * scattering, equilibrium)

    def compute_air_equilibrium(self) -> np.ndarray:
        """Return the radiance of each state in equilibrium with a radiance of 1 in air.

        Returns
        -------
        float, shape (..., wavelengths, states)
            n² times the fraction of the pores.
        """
        shape = self.grain_absorption.shape
        if self.grains.n_states == 1:
            return np.ones((*shape, 1))
        wet_fraction = np.maximum(self.wet_fraction, MIN_WET_FRACTION)[..., np.newaxis]
        wet = np.broadcast_to(wet_fraction * self.water_index**2, shape)
        return np.stack([np.broadcast_to(1.0 - wet_fraction, shape), wet], axis=-1)

    def compute_optics_error(self) -> np.ndarray:
        """Return the error of a reflectance, see `splits.discrete_ordinates.granular_stack`."""
        if isinstance(self.grains, GrainTable):
            return self.grains.interpolate_stderr(self.contrast, self.grain_absorption)
        return np.hypot(self.grains.interpolation_bound, self.compute_extent_bound())

    def compute_extent_bound(self) -> np.ndarray:
        """Return the bound on the error of fluxes due to the extent of traced grains."""
        if isinstance(self.grains, GrainTable):
            return np.zeros(self.contrast.shape)
        return self.extent_error + self.grains.compute_thinness_error(self.depth_m)


VARIABLE_FIELDS = (
    "depth_m", "collisions_per_m", "wet_fraction", "grain_absorption", "pore_absorption",
)  # fmt: skip
"""Properties of a layer that depend on its parameters; the others are those of its materials."""


def join_layers(layers: Sequence[GranularLayer]) -> GranularLayer:
    """Return dry layers of the same materials and grains along a leading dimension."""
    values: Any = {
        name: np.stack([getattr(one, name) for one in layers]) for name in VARIABLE_FIELDS
    }
    return layers[0]._replace(**values)


def _balance_states(
    moments: np.ndarray, wet_fraction: np.ndarray, ratio: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the symmetric scattering between dry and wet pores, and their equilibrium.

    In equilibrium, as much light changes from dry to wet pores as back.  The equilibrium of the
    traced grains is that of the moments of order 0.  Moments of higher orders are the mean of both
    directions, which differ as far as the rules within a grain are not reciprocal.  With another
    equilibrium, so are those of order 0, and the rest of the light stays in its pores.

    Parameters
    ----------
    moments : float, shape (..., wavelengths, 2, 2, orders)
        See `GrainTable`.
    wet_fraction : float, shape (..., 1)
    ratio : float, shape (..., wavelengths), optional
        Radiance of wet pores over that of dry ones; by default that of the traced grains.

    Returns
    -------
    float (..., wavelengths, 2, 2, orders), float (..., wavelengths, 2)
        Divided by the square roots of the radiances of both states in equilibrium; these radiances,
        of which that of dry pores is their fraction.
    """
    fraction = wet_fraction[..., np.newaxis]
    into_wet = fraction * moments[..., DRY, 1, :]
    into_dry = moments[..., WET, 0, :] - fraction * moments[..., WET, 1, :]
    is_given = ratio is not None
    if ratio is None:
        # Grains that absorb all light exchange none.
        ratio = np.maximum(into_wet[..., 0], TINY) / np.maximum(into_dry[..., 0], TINY)
    root = np.sqrt(ratio)[..., np.newaxis]
    exchange = 0.5 * (into_wet / root + into_dry * root)
    if is_given:
        into_wet, into_dry = exchange * root, exchange / root
    scattering = np.empty_like(moments)
    scattering[..., DRY, DRY, :] = moments[..., DRY, 0, :] - into_wet
    scattering[..., WET, WET, :] = moments[..., WET, 0, :] - into_dry
    scattering[..., DRY, WET, :] = scattering[..., WET, DRY, :] = exchange
    dry = np.broadcast_to(1.0 - wet_fraction, ratio.shape)
    return scattering, np.stack([dry, dry * ratio], axis=-1)


# --------------------------------------------------------------------------------------------------
# Replicates of layers with traced grains, each without one batch of rays, and their scatter.


def list_traced(layers: Sequence[GranularLayer]) -> list[str]:
    """Return the digests of the traced grains of layers."""
    sources = (layer.grains for layer in layers)
    return sorted({grains.digest for grains in sources if isinstance(grains, TracedGrains)})


def iterate_replicates(
    layers: Sequence[GranularLayer], digest: str
) -> Iterator[list[GranularLayer]]:
    """Yield the layers with each replicate of the traced grains of a digest."""
    for number in range(1, 1 + N_SCATTERING_BATCHES):
        yield [
            layer._replace(grains=layer.grains._replace(replicate=number))
            if isinstance(layer.grains, TracedGrains) and layer.grains.digest == digest
            else layer
            for layer in layers
        ]


def compute_replicate_error(
    layers: Sequence[GranularLayer], solve: Callable[[list[GranularLayer]], np.ndarray]
) -> np.ndarray:
    """Return the error of a result due to the paths through single grains (jackknife).

    Those through the grains of different layers are independent.

    Parameters
    ----------
    layers : sequence of GranularLayer
        With traced grains.
    solve : callable
        Returns the result for layers.
    """
    variance: Any = 0.0
    for digest in list_traced(layers):
        results = np.array([solve(one) for one in iterate_replicates(layers, digest)])
        variance = variance + compute_jackknife_stderr(results) ** 2
    return np.sqrt(variance)
