"""Part of a table for one direction of observation, a field of view, and a sky.

Values of directions between those of a table are interpolated.  A field of view averages them over
a cone, with the cosine of the polar angle as weight (Schaepman-Strub et al. 2006, Remote Sensing of
Environment 103, 27).  A part of the light may be isotropic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import xarray as xr

from splits.core.arrays import align_to_labels, check_array_range
from splits.core.declarations import Quantity
from splits.core.inputs import AZIMUTH_ANGLE, POLAR_ANGLE, check_azimuths
from splits.core.validation import check_number, invalid
from splits.tables.axes import (
    AZIMUTH,
    DIFFUSE_PREFIX,
    INCIDENCE,
    MIXED_QUANTITIES,
    POLAR,
    fold_azimuths,
    list_axes,
)

N_RINGS, N_RING_DIRECTIONS = 3, 8
"""Numbers of rings of a field of view, and of directions in each."""
VIEW_POLAR = replace(POLAR_ANGLE, low=0.0, high=90.0, open_high=True, check=None, schema=None)


def check_view_azimuth(key: str, azimuth_deg: Any) -> float:
    """Return an azimuth from 0 to below 360 degrees, after checking it."""
    return check_azimuths(key, check_number(key, azimuth_deg)).item()


ViewPolar = Annotated[float, VIEW_POLAR]
ViewAzimuth = Annotated[
    float,
    replace(AZIMUTH_ANGLE, check=check_view_azimuth, schema={"type": "number"}),
]
FieldOfView = Annotated[
    float,
    Quantity("full angle of a conical field of view", "degree", low=0.0, high=60.0),
]


Estimate = tuple[xr.DataArray, xr.DataArray]
"""Values and standard errors."""


def choose_direction(
    dataset: xr.Dataset, polar_deg: float, azimuth_deg: float | None
) -> dict[str, float]:
    """Return the angles of a direction, with an azimuth from 0 to 180 degrees.

    It is the first of the table where the azimuth has no effect.

    Raises
    ------
    ValueError
        For a table without directions, or a missing azimuth.
    """
    axes = list_axes(dataset)
    if POLAR not in axes:
        allowed = "left out for a table without directions"
        raise invalid(POLAR, polar_deg, allowed, f"axes {', '.join(axes)}")
    nodes = dataset[AZIMUTH].values if AZIMUTH in dataset.dims else np.zeros(1)
    beams = dataset[INCIDENCE] if INCIDENCE in dataset else dataset.attrs.get(INCIDENCE, 0.0)
    if polar_deg == 0.0 or AZIMUTH not in dataset.dims or (np.ravel(beams) == 0.0).all():
        azimuth_deg = nodes[0]
    elif azimuth_deg is None and nodes.size > 1:
        raise invalid(AZIMUTH, None, "given", "an axis of the table")
    azimuth = nodes[0] if azimuth_deg is None else azimuth_deg
    return {POLAR: polar_deg, AZIMUTH: float(fold_azimuths(azimuth))}


def check_diffuse_fraction(dataset: xr.Dataset, diffuse_fraction: Any) -> np.ndarray:
    """Return the fraction of isotropic light, a number or one for each wavelength of a table."""
    fraction = np.asarray(diffuse_fraction, dtype=float)
    if np.ndim(diffuse_fraction):
        wavelengths = dataset.wavelength.values
        fraction = align_to_labels("diffuse_fraction", diffuse_fraction, wavelengths)
        if fraction.shape != wavelengths.shape:
            allowed = f"a number, or {wavelengths.size}, one for each wavelength"
            raise invalid("diffuse_fraction", f"of shape {fraction.shape}", allowed)
    check_array_range("diffuse_fraction", np.atleast_1d(fraction), 0.0, 1.0)
    # A mixture of anisotropy factors is weighted by the reflectances.
    names = [name for name in MIXED_QUANTITIES if name in dataset]
    beam = ["reflectance"] if "anisotropy_factor" in names else []
    needed = [*dict.fromkeys([*beam, *names])]
    needed += [DIFFUSE_PREFIX + name for name in needed]
    missing = [name for name in needed if name not in dataset]
    if fraction.any() and missing:
        hint = f"the table lacks {', '.join(missing)}, see quantities of splits.build_table"
        raise invalid("diffuse_fraction", diffuse_fraction, "0 for this table", hint)
    return fraction


def list_directions(
    center: Mapping[str, float], field_of_view_deg: float
) -> list[tuple[Mapping[str, float], float]]:
    """Return the angles of directions in a field of view, with weights of a sum of 1."""
    if field_of_view_deg == 0.0:
        return [(center, 1.0)]
    nodes, weights = np.polynomial.legendre.leggauss(N_RINGS)
    half_angle = np.radians(0.5 * field_of_view_deg)
    cosine = 1.0 - 0.5 * (1.0 - np.cos(half_angle)) * (1.0 + nodes)
    turn = 2.0 * np.pi * (np.arange(N_RING_DIRECTIONS) + 0.5) / N_RING_DIRECTIONS
    sine = np.sqrt(1.0 - cosine**2)[:, np.newaxis]
    x, y = sine * np.cos(turn), sine * np.sin(turn)
    z = np.broadcast_to(cosine[:, np.newaxis], x.shape)
    tilt, azimuth = np.radians([center[POLAR], center[AZIMUTH]])
    x, z = x * np.cos(tilt) + z * np.sin(tilt), z * np.cos(tilt) - x * np.sin(tilt)
    angles = np.degrees([np.arccos(z), azimuth + np.arctan2(y, x)]).reshape(2, -1)
    fractions = np.repeat(weights, N_RING_DIRECTIONS) * z.ravel()
    fractions = fractions / fractions.sum()
    return [
        ({POLAR: polar, AZIMUTH: float(fold_azimuths(azimuth))}, fraction)
        for polar, azimuth, fraction in zip(*angles.tolist(), fractions.tolist(), strict=True)
    ]


def mix_light(
    direct: dict[str, Estimate], diffuse: dict[str, Estimate], fraction: xr.DataArray
) -> dict[str, Estimate]:
    """Return quantities under a mixture of a beam and isotropic light.

    Errors of both are added, as they may be correlated.
    """

    def combine(name: str) -> Estimate:
        value, error = (
            (1.0 - fraction) * one + fraction * other
            for one, other in zip(direct[name], diffuse[name], strict=True)
        )
        return value, error

    mixed = {name: combine(name) for name in direct if name != "anisotropy_factor"}
    if "anisotropy_factor" in direct:
        (beam, beam_error), (sky, sky_error) = (
            one["anisotropy_factor"] for one in (direct, diffuse)
        )
        reflectance = direct["reflectance"], diffuse["reflectance"]
        first, second = (1.0 - fraction) * reflectance[0][0], fraction * reflectance[1][0]
        # Without light, the fraction of the beam in the reflected light is 0.
        beam_fraction = (first / (first + second).where(first + second > 0.0)).fillna(0.0)
        relative = sum(
            (error / value.where(value > 0.0)).fillna(0.0) for value, error in reflectance
        )
        sky_fraction = 1.0 - beam_fraction
        error = beam_fraction * beam_error + sky_fraction * sky_error
        error = error + np.abs(beam - sky) * beam_fraction * sky_fraction * relative
        mixed["anisotropy_factor"] = (beam_fraction * beam + sky_fraction * sky, error)
    return mixed
