"""Diffusion properties of a deep layer, and the response of the part below a truncation depth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from splits.kernels.base.scene import DRY_PORE, WET_PORE
from splits.media.ground import Ground
from splits.media.medium import GranularMedium, Medium
from splits.simulation.diffusion import (
    DiffusiveSubstrate,
    diffuse_reflectance,
    effective_mean_free_path,
)
from splits.simulation.scene import compute_material_constants
from splits.simulation.truncated_medium import ERROR_BUDGET_FRACTION, THEORY_UNCERTAINTY

MAX_DECAY_EXPONENT = 5.0
"""Media are not truncated where light decays by more than exp(−MAX_DECAY_EXPONENT) down to the
truncation depth at all wavelengths."""
MIN_DEPTH_IN_D = 30.0
"""Smallest truncation depth in units of D, which is a third of the transport mean free path."""
MIN_TRANSPORT_FACTOR = 0.01
"""Smallest 1 − ωg of grains for which diffusion theory is used."""


class DiffusionProperties(NamedTuple):
    """Diffusion properties of a granular medium at each wavelength.

    Attributes
    ----------
    coalbedo : float
        Fraction of the light that a grain absorbs, 1 − ω.
    transport_factor : float
        1 − g + (1 − ω), which is 1 − ωg where little is absorbed.
    diffusion_coefficient : float
        D (m).
    decay_rate : float
        Rate at which diffuse light decays with depth (1/m).
    """

    coalbedo: np.ndarray
    transport_factor: np.ndarray
    diffusion_coefficient: np.ndarray
    decay_rate: np.ndarray

    @classmethod
    def from_optics(cls, optics: xr.Dataset) -> DiffusionProperties:
        """Return the properties for single-scattering properties, see `pool_optics_by_type`."""
        mean_free_path = effective_mean_free_path(optics)
        coalbedo = np.maximum(1.0 - optics.single_scattering_albedo.values, 0.0)
        transport_factor = 1.0 - optics.asymmetry_parameter.values + coalbedo
        diffusion_coefficient = mean_free_path / (
            3.0 * np.maximum(transport_factor, np.finfo(float).tiny)
        )
        return cls(
            coalbedo,
            transport_factor,
            diffusion_coefficient,
            np.sqrt(coalbedo / mean_free_path / diffusion_coefficient),
        )

    def compute_truncation_depth(
        self, lowest_layer: GranularMedium, max_stderr: float, undisturbed_depth_m: float = 0.0
    ) -> float:
        """Return the truncation depth below the top of the lowest layer (m).

        See `truncate_deep_medium` for the parameters.
        """
        # The error is at most THEORY_UNCERTAINTY/4 of the light that reaches the truncation depth,
        # which is 4 D over that depth.
        depth_in_d = THEORY_UNCERTAINTY / (ERROR_BUDGET_FRACTION * max_stderr)
        max_diffusion = float(self.diffusion_coefficient.max())
        # Above this distance the truncation does not change the angular distribution of the light.
        margin = max(MIN_DEPTH_IN_D * max_diffusion, 2.0 * lowest_layer.largest_grain_m)
        return max(max_diffusion * depth_in_d, undisturbed_depth_m + margin)

    def compute_regularized_rate(self, truncation_depth_m: float) -> np.ndarray:
        """Return the decay rate (1/m), slightly above 0 where nothing absorbs, to avoid 0/0."""
        return np.maximum(self.decay_rate, 1e-9 / truncation_depth_m)

    def is_truncation_worthwhile(
        self, lowest_layer: GranularMedium, max_stderr: float, margin: float = 1.0
    ) -> bool:
        """Return whether truncation saves time in a finite layer, or may, within a margin."""
        depth = self.compute_truncation_depth(lowest_layer, max_stderr)
        is_deep = lowest_layer.depth_m * margin >= 4.0 * depth
        return bool(
            self.transport_factor.min() * margin >= MIN_TRANSPORT_FACTOR
            and is_deep
            and (self.decay_rate * depth).min() <= MAX_DECAY_EXPONENT * margin
        )


class SubstrateResponse(NamedTuple):
    """Response of the part of a medium below the truncation depth; see `TruncatedMedium`.

    Attributes
    ----------
    reflected_fraction : float
        Fraction of the incident diffuse light that is reflected, by wavelength.
    transmitted_fraction, conservative, escape_probability
        As of a `TruncatedMedium`.
    """

    reflected_fraction: np.ndarray
    transmitted_fraction: np.ndarray
    conservative: np.ndarray
    escape_probability: np.ndarray

    @classmethod
    def from_diffusion(
        cls,
        medium: Medium,
        size_ratio: float,
        properties: DiffusionProperties,
        wavelengths: np.ndarray,
        truncation_depth_m: float,
    ) -> SubstrateResponse:
        """Return the response of a medium of a given size with the given diffusion properties."""
        depth = float(medium.lowest_layer.depth_m) / size_ratio
        rate = properties.compute_regularized_rate(truncation_depth_m)
        diffusion = properties.diffusion_coefficient
        ground = None if medium.is_semi_infinite else medium.ground
        albedo = np.zeros_like(rate) if ground is None else ground.albedo(wavelengths)
        substrate = DiffusiveSubstrate(
            rate * diffusion,
            rate * (depth - truncation_depth_m),
            0.5 * (1.0 - albedo) / (1.0 + albedo),
        )
        lossless = properties.coalbedo <= 0.0
        reflected = np.where(
            lossless & (medium.is_semi_infinite | (albedo == 1.0)),
            1.0,
            substrate.compute_reflected_fraction(),
        )
        transmitted = np.where(
            lossless & (reflected < 1.0), 1.0, substrate.compute_transmitted_fraction()
        )
        arriving = 1.0 / (1.0 + 0.75 * truncation_depth_m / (diffusion * 3.0))
        escape = arriving / (arriving + 1.0 - reflected)
        absorbs_above = _has_absorption_above(medium, wavelengths)
        return cls(reflected, transmitted, (transmitted == 1.0) & ~absorbs_above, escape)


def _has_absorption_above(medium: Medium, wavelengths: np.ndarray) -> np.ndarray:
    """Return at which wavelengths a layer above the lowest one may absorb."""
    n_materials_above = len(medium.list_materials()) - len(medium.lowest_layer.list_materials())
    absorption = compute_material_constants(medium, wavelengths).absorption
    particles_absorb = [layer.single_scattering_albedo < 1.0 for layer in medium.scene_layers]
    materials_absorb = (absorption[:, :n_materials_above] > 0.0).any(axis=1)
    return np.asarray(materials_absorb | any(particles_absorb))


def select_least_attenuated(
    properties: Sequence[DiffusionProperties], truncation_depth_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return decay rate (1/m) and D (m) of the medium with the slowest decay, by wavelength."""
    rate = np.stack([one.compute_regularized_rate(truncation_depth_m) for one in properties])
    diffusion = np.stack([one.diffusion_coefficient for one in properties])
    slowest = rate.argmin(axis=0), np.arange(rate.shape[1])
    return rate[slowest], diffusion[slowest]


def compute_semi_infinite_depth(
    decay_rate: np.ndarray, diffusion_coefficient: np.ndarray, max_stderr: float
) -> float:
    """Return the smallest depth (m) over a black ground with the reflectance of infinite depth."""
    depths = np.geomspace(1e-4, 1e4, 1601)[:, np.newaxis]
    black = np.full_like(decay_rate, 0.5)
    finite, semi_infinite = (
        DiffusiveSubstrate(
            decay_rate * diffusion_coefficient, decay_depth, black
        ).compute_reflected_fraction()
        for decay_depth in (decay_rate * depths, np.full_like(decay_rate, np.inf))
    )
    n_differing = np.abs(semi_infinite - finite).max(axis=1) > max_stderr
    return float(depths[min(n_differing.sum(), len(depths) - 1), 0])


def compute_albedo_below_interface(
    reflected_fraction: np.ndarray,
    indices: np.ndarray,
    lowest_layer: GranularMedium,
    optics: xr.Dataset,
) -> np.ndarray:
    """Return the albedo of a ground below a wet-pore interface for a given reflectance.

    An interface reflects the diffuse light of wet pores more strongly from inside than from
    outside, by a factor n², by reciprocity.
    """
    if (
        not lowest_layer.wet_fraction
        or not lowest_layer.interpretation.to_sampling_rules(False).boundary_fresnel
    ):
        return reflected_fraction
    index = indices.real
    n = index[:, WET_PORE] / index[:, DRY_PORE]
    external_reflectance = diffuse_reflectance(n)
    internal_reflectance = 1.0 - (1.0 - external_reflectance) / n**2
    transmitted = 1.0 - optics.wet_fraction.values * internal_reflectance
    entering = 1.0 - float(lowest_layer.wet_fraction) * external_reflectance
    # The absorptance below, per incident light at the interface from inside, is 1 − reflected.
    absorbed = 1.0 - reflected_fraction
    albedo = (transmitted - absorbed) / (transmitted - absorbed * (1.0 - entering))
    return np.clip(albedo, 0.0, 1.0)


def make_substrate_ground(wavelengths: np.ndarray, albedo: np.ndarray) -> Ground:
    """Return the ground that replaces the part below the truncation depth."""
    spectrum = (albedo,) if wavelengths.size == 1 else (albedo, wavelengths)
    return Ground("substrate of a truncated medium", "diffusion theory", *spectrum)
