"""Optically deep media: tracing to a truncation depth, and a boundary that replaces the rest.

Where little is absorbed, light in a deep medium is scattered by ten thousand grains before it
leaves.  Far below the surface it is diffuse, and diffusion theory gives the reflectance of the rest
of the medium: F↓ and F↑ are φ/4 ± J/2, and φ obeys D φ″ = μ φ (Ishimaru 1978, Wave Propagation and
Scattering in Random Media, chapter 9).  Rays are therefore traced down to a truncation depth only.
A Lambertian boundary there reflects what the rest would reflect at each wavelength.

The error of the theory enters the standard errors: it is `THEORY_UNCERTAINTY` of the light that the
rest keeps, times the probability that light from the truncation depth escapes at the top.  The
truncation depth is chosen so that this is a fraction of the requested error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from splits.core.validation import invalid
from splits.kernels.scene import DRY_PORE, WET_PORE
from splits.media.ground import Ground
from splits.media.medium import GranularMedium, Medium
from splits.simulation.grain_optics import (
    GRAIN_RAYS_PER_CHUNK,
    GrainOpticsRequest,
    estimate_pilot_optics,
    pool_optics_by_type,
)
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import OpticalConstants, compute_material_constants
from splits.simulation.shared_paths import GROUND_DERIVATIVE, PathSharingMedia
from splits.simulation.spectral_tally import Derivatives, SpectralEstimate

# --------------------------------------------------------------------------------------------------
# Diffusion theory of deep layers: effective mean free path, and reflectance of a substrate.
#
# Of the fluence rate φ and the net flux J, F↓ and F↑ are φ/4 ± J/2; J = −D φ′ and D φ″ = μ φ, which
# decays by exp(−κ z) (Ishimaru 1978, Wave Propagation and Scattering in Random Media, chapter 9).


def effective_mean_free_path(optics: xr.Dataset) -> np.ndarray:
    """Return the mean free path (m) of point scatterers that diffuse light as finite grains do.

    Light advances from grain to grain by l = 1/extinction, and by a displacement δ from entry to
    exit within each grain.  Diffusion over many grains is that of points at the mean distance

        l'² = (l + <δ·d>) (l + <δ·d'>) + (1 − g) <δ²>/2,

    d and d' the directions before and after: half the mean square displacement per grain, summed
    over the correlations g, g², … of directions, is l'²/(1 − g).
    """
    # Plain arrays add a hundred times faster than labelled ones.
    free = 1.0 / optics.extinction.values
    incident, exit = optics.displacement_along_incident, optics.displacement_along_exit
    transport_factor = 1.0 - optics.asymmetry_parameter.values
    spread = 0.5 * transport_factor * optics.mean_square_displacement.values
    return np.sqrt((free + incident.values) * (free + exit.values) + spread)


def diffuse_reflectance(n: np.ndarray) -> np.ndarray:
    """Return the reflectance of an interface for diffuse light from the side of index 1.

    It is the cosine-weighted mean of the Fresnel reflectance.

    Parameters
    ----------
    n : float, shape (...)
        Index of the far side, positive.
    """
    node, weight = np.polynomial.legendre.leggauss(256)
    mu, weight = 0.5 * (1.0 + node), 0.5 * weight
    n = np.asarray(n, dtype=float)
    # From the dense side, where the integrand has a corner, by reciprocity.
    dense = np.maximum(n, 1.0 / n)[..., np.newaxis]
    inner = np.sqrt(1.0 - (1.0 - mu**2) / dense**2)
    s_polarized = ((mu - dense * inner) / (mu + dense * inner)) ** 2
    p_polarized = ((dense * mu - inner) / (dense * mu + inner)) ** 2
    values: np.ndarray = (weight * mu * (s_polarized + p_polarized)).sum(axis=-1)
    return np.where(n < 1.0, 1.0 - (1.0 - values) * n**2, values)


class DiffusiveSubstrate(NamedTuple):
    """Diffusion-theory description of the medium below a truncation depth, by wavelength.

    Attributes
    ----------
    decay_flux_ratio : float
        κ D, the net flux over the fluence rate of light that decays by exp(−κ z).
    decay_depth : float
        κ h.
    bottom_flux_ratio : float
        Net flux over fluence rate at the bottom, (1 − ρ)/(2 (1 + ρ)) over an albedo ρ.
    """

    decay_flux_ratio: np.ndarray
    decay_depth: np.ndarray
    bottom_flux_ratio: np.ndarray

    def compute_flux_ratio(self) -> np.ndarray:
        """Return the net flux over the fluence rate at the truncation depth."""
        tanh = np.tanh(self.decay_depth)
        upper = self.bottom_flux_ratio + self.decay_flux_ratio * tanh
        lower = self.decay_flux_ratio + self.bottom_flux_ratio * tanh
        return self.decay_flux_ratio * upper / lower

    def compute_reflected_fraction(self) -> np.ndarray:
        """Return the reflectance for diffuse light."""
        flux_ratio = self.compute_flux_ratio()
        values: np.ndarray = (1.0 - 2.0 * flux_ratio) / (1.0 + 2.0 * flux_ratio)
        return np.clip(values, 0.0, 1.0)

    def compute_transmitted_fraction(self) -> np.ndarray:
        """Return the fraction of the net flux at the truncation depth that enters the bottom."""
        depth, ratio = np.minimum(self.decay_depth, 700.0), self.decay_flux_ratio
        fluence = ratio / (ratio * np.cosh(depth) + self.bottom_flux_ratio * np.sinh(depth))
        transmitted = self.bottom_flux_ratio * fluence / self.compute_flux_ratio()
        return np.clip(np.where(self.decay_depth > 700.0, 0.0, transmitted), 0.0, 1.0)


# --------------------------------------------------------------------------------------------------
# Truncated media: results of a whole medium from those of the part above a truncation depth.

THEORY_UNCERTAINTY = 0.3
"""Relative uncertainty of the diffusion-theory absorptance below the truncation depth."""
ERROR_BUDGET_FRACTION = 0.4
"""Fraction of the requested error that the truncation may contribute."""


class TruncatedMedium(NamedTuple):
    """A truncated medium, or several that share paths, with one truncation depth.

    Attributes
    ----------
    path_sharing : PathSharingMedia
        Media down to the truncation depth, over grounds that replace the rest.
    depth_m : float
        Truncation depth (m).
    transmitted_fraction : float, shape (media, wavelengths)
        Fraction of the light that enters the rest which leaves it at the bottom.
    conservative : bool, shape (media, wavelengths)
        Whether nothing absorbs, below the truncation depth and above, and the ground below
        transmits what it does not reflect.
    escape_probability : float, shape (media, wavelengths)
        Probability that light from the truncation depth escapes at the top.
    ground_absorption : float, shape (media, wavelengths)
        Absorption of the ground that replaces the rest, −ln of its albedo.
    semi_infinite_depth_m : float
        Depth above which the lowest layer reflects diffuse light like a semi-infinite one, within
        the requested error, by diffusion theory (m).
    """

    path_sharing: PathSharingMedia
    depth_m: float
    transmitted_fraction: np.ndarray
    conservative: np.ndarray
    escape_probability: np.ndarray
    ground_absorption: np.ndarray
    semi_infinite_depth_m: float

    def complete_estimate(self, above: SpectralEstimate) -> SpectralEstimate:
        """Return the estimate of whole media, but for the perturbed ones, from the parts above."""
        n_media = self.path_sharing.n_reported
        transmitted_fraction, conservative, escape = (
            x[:n_media].ravel()
            for x in (self.transmitted_fraction, self.conservative, self.escape_probability)
        )
        entering = above.mean[1]
        reflected = np.minimum(above.mean[0], 1.0)
        # Where nothing is absorbed, transmittance is 1 − reflectance, and has the same error.
        transmitted = np.where(
            conservative,
            1.0 - reflected,
            np.minimum(entering * transmitted_fraction, 1.0 - reflected),
        )
        mean = np.stack([reflected, transmitted, 1.0 - reflected - transmitted])
        reflected_error = THEORY_UNCERTAINTY * entering * escape
        transmitted_error = np.where(
            transmitted_fraction == 1.0, reflected_error, THEORY_UNCERTAINTY * transmitted
        )
        absorbed_error = np.where(conservative, 0.0, np.hypot(reflected_error, transmitted_error))
        theory_error = np.stack([reflected_error, transmitted_error, absorbed_error])
        scale = np.stack([np.ones_like(entering), transmitted_fraction, np.ones_like(entering)])
        statistical_error = scale * above.stderr
        # The absorptance is that above the truncation depth plus that of the rest: everything
        # that is neither reflected nor transmitted.
        statistical_error[2] = np.minimum(
            statistical_error[2] + (1.0 - transmitted_fraction) * above.stderr[1],
            statistical_error[0] + statistical_error[1],
        )
        statistical_error[1, conservative] = statistical_error[0, conservative]
        statistical_error[2, conservative] = 0.0
        stderr = np.hypot(statistical_error, theory_error)
        batch_deviations = above.batch_deviations * scale[:2]
        batch_deviations[:, 1, conservative] = -batch_deviations[:, 0, conservative]
        interpolation_error = np.hypot(scale * above.interpolation_error, theory_error)
        return replace(
            above,
            mean=mean,
            stderr=stderr,
            interpolation_error=interpolation_error,
            batch_deviations=batch_deviations,
        )

    def complete_derivatives(self, above: SpectralEstimate, steps: np.ndarray) -> Derivatives:
        """Return derivatives of the whole first medium from those of the part above.

        Changes of the reflectance and transmittance of the rest follow from diffusion theory, whose
        relative uncertainty applies to them.
        """
        step = steps[:, np.newaxis]
        ground_change = (self.ground_absorption[1:] - self.ground_absorption[0]) / step
        transmitted_change = (self.transmitted_fraction[1:] - self.transmitted_fraction[0]) / step
        along_paths = above.derivatives.select(slice(None, GROUND_DERIVATIVE))
        ground_mean = above.derivatives.mean[:, GROUND_DERIVATIVE, np.newaxis]
        entering, transmitted_fraction = above.mean[1], self.transmitted_fraction[0]
        scale = np.stack([np.ones_like(transmitted_fraction), transmitted_fraction])[:, np.newaxis]
        theory_term = np.stack([np.zeros_like(transmitted_change), entering * transmitted_change])
        batch_deviations = along_paths.batch_deviations * scale
        batch_deviations[:, 1] += above.batch_deviations[:, 1, np.newaxis] * transmitted_change
        theory_error = THEORY_UNCERTAINTY * (
            scale * np.abs(ground_change * ground_mean) + np.abs(theory_term)
        )
        bias_bound = np.hypot(scale * along_paths.bias_bound, theory_error)
        return Derivatives(along_paths.mean * scale + theory_term, batch_deviations, bias_bound)


# --------------------------------------------------------------------------------------------------
# Diffusion properties of a deep layer, and the response of the part below a truncation depth.

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


def compute_substrate_response(
    medium: Medium,
    size_ratio: float,
    properties: DiffusionProperties,
    wavelengths: np.ndarray,
    truncation_depth_m: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the response of the part of a medium below the truncation depth, by wavelength.

    Parameters
    ----------
    medium : Medium
    size_ratio : float
        Its size in units of the first's.
    properties : DiffusionProperties
    wavelengths : float, shape (wavelengths,)
        nm.
    truncation_depth_m : float

    Returns
    -------
    reflected_fraction : float
        Fraction of the incident diffuse light that is reflected.
    transmitted_fraction, conservative, escape_probability
        As of a `TruncatedMedium`.
    """
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
    # A layer above the lowest one may absorb, too.
    n_materials_above = len(medium.list_materials()) - len(medium.lowest_layer.list_materials())
    absorption = compute_material_constants(medium, wavelengths).absorption
    particles_absorb = any(layer.single_scattering_albedo < 1.0 for layer in medium.scene_layers)
    absorbs_above = (absorption[:, :n_materials_above] > 0.0).any(axis=1) | particles_absorb
    return reflected, transmitted, (transmitted == 1.0) & ~absorbs_above, escape


def compute_semi_infinite_depth(
    properties: Sequence[DiffusionProperties], truncation_depth_m: float, max_stderr: float
) -> float:
    """Return the smallest depth (m) over a black ground with the reflectance of infinite depth.

    It is that of the medium in which light decays most slowly, at each wavelength.
    """
    rates = np.stack([one.compute_regularized_rate(truncation_depth_m) for one in properties])
    coefficients = np.stack([one.diffusion_coefficient for one in properties])
    slowest = rates.argmin(axis=0), np.arange(rates.shape[1])
    decay_rate, diffusion_coefficient = rates[slowest], coefficients[slowest]
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


# --------------------------------------------------------------------------------------------------
# Optically deep media: tracing to a truncation depth, and a boundary that replaces the rest.

MIN_DEPTH_MFP = 600.0
"""Depth in mean distances between grains up to which tracing the whole medium is fast."""
PILOT_MARGIN = 2.0
"""Factor by which a pilot estimate must exceed a limit for the full estimate to be skipped."""
OPTICS_RAYS_PER_TYPE = GRAIN_RAYS_PER_CHUNK
"""Rays per grain type: the asymmetry is then known to 2 %, far better than `THEORY_UNCERTAINTY`."""
OPTICS_PILOT_RAYS = 256
"""Rays of the pilot estimate, far more precise than `PILOT_MARGIN`; rare absorbing grains may be
undersampled, in which case the full estimate is made."""


def truncate_deep_medium(
    path_sharing: PathSharingMedia,
    wavelengths: np.ndarray,
    max_stderr: float,
    run: RunOptions,
    undisturbed_depth_m: float = 0.0,
) -> TruncatedMedium | None:
    """Return truncated media where that serves the requested error, None where it does not.

    Parameters
    ----------
    path_sharing : PathSharingMedia
        Media that share paths.
    wavelengths : float, shape (wavelengths,)
        nm.
    max_stderr : float
        As for the spectrophotometer.
    run : RunOptions
        Its seed and threads apply to the rays of single grains.
    undisturbed_depth_m : float
        Depth (m) in the lowest layer above which the truncation must not change the light.

    Raises
    ------
    ValueError
        For an infinite layer to which diffusion theory does not apply: other fluids in its pores,
        or grains that hardly turn light.
    """
    all_lowest = (medium.lowest_layer for medium in path_sharing.media)
    lowest = [layer for layer in all_lowest if layer.has_grains]
    if not lowest or lowest[0].depth_m * lowest[0].extinction_per_m < MIN_DEPTH_MFP:
        return None
    layer = lowest[0]
    if any(one.pores or "air" in one.refractive_index for one in lowest):
        # The reflectance of the rest assumes pores of water and of air of index 1.
        if layer.is_semi_infinite:
            raise invalid("depth_m", math.inf, "finite where pores hold other media or other air")
        return None
    # The optical constants of all lowest layers, stacked, in units of the first's size.
    media, scales, _ = path_sharing
    indices, absorption = zip(
        *(compute_material_constants(one, wavelengths) for one in lowest), strict=True
    )
    scaled = [scale * one for scale, one in zip(scales, absorption, strict=True)]
    constants = OpticalConstants(np.concatenate(indices), np.concatenate(scaled))
    grain_run = run._replace(kernel="auto", progress=None)
    request = GrainOpticsRequest(1, OPTICS_RAYS_PER_TYPE, "equilibrium", grain_run)
    if not layer.is_semi_infinite:
        pilot = estimate_pilot_optics(layer, constants, request._replace(n_rays=OPTICS_PILOT_RAYS))
        pilots = _split_by_medium(pilot, len(lowest))
        properties = [DiffusionProperties.from_optics(one) for one in pilots]
        if not any(
            one.is_truncation_worthwhile(layer, max_stderr, PILOT_MARGIN) for one in properties
        ):
            return None
    optics = _split_by_medium(pool_optics_by_type(layer, constants, request), len(lowest))
    properties = [DiffusionProperties.from_optics(one) for one in optics]
    if layer.is_semi_infinite:
        if min(one.transport_factor.min() for one in properties) < MIN_TRANSPORT_FACTOR:
            raise invalid("depth_m", math.inf, "finite", "these grains hardly turn light")
    elif not any(one.is_truncation_worthwhile(layer, max_stderr) for one in properties):
        return None
    depth = max(
        one.compute_truncation_depth(layer, max_stderr, undisturbed_depth_m) for one in properties
    )
    responses = [
        compute_substrate_response(medium, scale, one, wavelengths, depth)
        for medium, scale, one in zip(media, scales, properties, strict=True)
    ]
    reflected, transmitted, conservative, escape = map(np.stack, zip(*responses, strict=True))
    # Media that share paths all have a ground, or none.
    min_albedo = np.finfo(float).tiny if len(media) > 1 else 0.0
    truncated, grounds = [], []
    for medium, scale, one, index, fraction, grains in zip(
        media, scales, lowest, indices, reflected, optics, strict=True
    ):
        below = compute_albedo_below_interface(fraction, index, one, grains)
        albedo = np.maximum(below, min_albedo)
        spectrum = (albedo,) if wavelengths.size == 1 else (albedo, wavelengths)
        ground = Ground("substrate of a truncated medium", "diffusion theory", *spectrum)
        grounds.append(ground.optical_depth(wavelengths))
        truncated.append(medium.truncate(scale * depth, ground))
    return TruncatedMedium(
        path_sharing._replace(media=tuple(truncated)),
        depth,
        transmitted,
        conservative,
        escape,
        np.stack(grounds),
        compute_semi_infinite_depth(properties, depth, max_stderr),
    )


def _split_by_medium(optics: xr.Dataset, n_media: int) -> list[xr.Dataset]:
    """Return the single-scattering properties of each medium."""
    parts = {name: np.split(one.values, n_media) for name, one in optics.data_vars.items()}
    return [xr.Dataset({n: ("row", part[i]) for n, part in parts.items()}) for i in range(n_media)]
