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

import numpy as np
import xarray as xr

from splits.core.validation import invalid
from splits.media.medium import GranularMedium
from splits.simulation.grain_optics import (
    GrainOpticsRequest,
    estimate_pilot_optics,
    pool_optics_by_type,
)
from splits.simulation.run_options import RunOptions
from splits.simulation.scene import OpticalConstants, compute_material_constants
from splits.simulation.single_scattering_tally import GRAIN_RAYS_PER_CHUNK
from splits.simulation.spectral_rows import PathSharingMedia
from splits.simulation.substrate import (
    MIN_TRANSPORT_FACTOR,
    DiffusionProperties,
    SubstrateResponse,
    compute_albedo_below_interface,
    compute_semi_infinite_depth,
    make_substrate_ground,
    select_least_attenuated,
)
from splits.simulation.truncated_medium import TruncatedMedium

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
    constants = _combine_constants(lowest, path_sharing.size_ratios, wavelengths)
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
    return _truncate(path_sharing, lowest, wavelengths, optics, max_stderr, undisturbed_depth_m)


def _combine_constants(
    layers: Sequence[GranularMedium], size_ratios: np.ndarray, wavelengths: np.ndarray
) -> OpticalConstants:
    """Return the optical constants of the lowest layers, stacked, in units of the first's size."""
    indices, absorption = zip(
        *(compute_material_constants(layer, wavelengths) for layer in layers), strict=True
    )
    scaled = [ratio * one for ratio, one in zip(size_ratios, absorption, strict=True)]
    return OpticalConstants(np.concatenate(indices), np.concatenate(scaled))


def _split_by_medium(optics: xr.Dataset, n_media: int) -> list[xr.Dataset]:
    """Return the single-scattering properties of each medium."""
    parts = {name: np.split(one.values, n_media) for name, one in optics.data_vars.items()}
    return [xr.Dataset({n: ("row", part[i]) for n, part in parts.items()}) for i in range(n_media)]


def _truncate(
    path_sharing: PathSharingMedia, lowest: Sequence[GranularMedium], wavelengths: np.ndarray,
    optics: Sequence[xr.Dataset], max_stderr: float, undisturbed_depth_m: float,
) -> TruncatedMedium | None:  # fmt: skip
    """Truncate media with given single-scattering properties, see `truncate_deep_medium`."""
    media, scales, _ = path_sharing
    properties = [DiffusionProperties.from_optics(one) for one in optics]
    layer = lowest[0]
    if layer.is_semi_infinite:
        if min(one.transport_factor.min() for one in properties) < MIN_TRANSPORT_FACTOR:
            raise invalid("depth_m", math.inf, "finite", "these grains hardly turn light")
    elif not any(one.is_truncation_worthwhile(layer, max_stderr) for one in properties):
        return None
    depth = max(
        one.compute_truncation_depth(layer, max_stderr, undisturbed_depth_m) for one in properties
    )
    substrates = [
        SubstrateResponse.from_diffusion(medium, scale, one, wavelengths, depth)
        for medium, scale, one in zip(media, scales, properties, strict=True)
    ]
    # Media that share paths all have a ground, or none.
    min_albedo = np.finfo(float).tiny if len(media) > 1 else 0.0
    truncated, grounds = [], []
    for medium, scale, layer, substrate, grains in zip(
        media, scales, lowest, substrates, optics, strict=True
    ):
        albedo = compute_albedo_below_interface(
            substrate.reflected_fraction,
            compute_material_constants(layer, wavelengths).indices,
            layer,
            grains,
        )
        ground = make_substrate_ground(wavelengths, np.maximum(albedo, min_albedo))
        grounds.append(ground.optical_depth(wavelengths))
        truncated.append(medium.truncate(scale * depth, ground))
    _, transmitted_fraction, conservative, escape_probability = map(
        np.stack, zip(*substrates, strict=True)
    )
    return TruncatedMedium(
        path_sharing._replace(media=tuple(truncated)),
        depth,
        transmitted_fraction,
        conservative,
        escape_probability,
        np.stack(grounds),
        compute_semi_infinite_depth(*select_least_attenuated(properties, depth), max_stderr),
    )
