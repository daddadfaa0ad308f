"""Part of a table for one direction of observation, a field of view, and a sky.

Values of directions between those of a table are interpolated.  A field of view averages them over
a cone, with the cosine of the polar angle as weight (Schaepman-Strub et al. 2006, Remote Sensing of
Environment 103, 27).  A part of the light may be isotropic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import xarray as xr

from splits.core.arrays import align_to_labels, check_array_range
from splits.core.declarations import Quantity
from splits.core.inputs import AZIMUTH_ANGLE, POLAR_ANGLE, check_azimuths
from splits.core.uncertainty import make_variable
from splits.core.validation import check_number, invalid, snap_to_limits
from splits.tables.axes import (
    AZIMUTH,
    DIFFUSE_PREFIX,
    INCIDENCE,
    MIXED_QUANTITIES,
    POLAR,
    VIEW_AXES,
    find_variables,
    fold_azimuths,
    list_axes,
    list_view_axes,
    load_selection,
)
from splits.tables.comparison import rename_comparison
from splits.tables.interpolation import check_within_axis
from splits.tables.located_quantity import LocatedQuantity, combine_axis_errors

if TYPE_CHECKING:
    from splits.tables.table import Table

N_RINGS, N_RING_DIRECTIONS = 3, 8
"""Numbers of rings of a field of view, and of directions in each."""
LABELS = {
    "reflectance": "reflectance",
    "reflectance_factor": "reflectance factor",
    "anisotropy_factor": "anisotropy factor",
}


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


def select_view(
    table: Table,
    center: Mapping[str, float],
    field_of_view_deg: float,
    diffuse_fraction: np.ndarray,
) -> xr.Dataset:
    """Return the table of spectra in one direction, with the interpolation error in its errors.

    Parameters
    ----------
    table : Table
        Table with directions of observation.
    center : mapping
        Direction, see `choose_direction`.
    field_of_view_deg : float
        Full angle of the cone.
    diffuse_fraction : float, shape () or (wavelengths,)
        See `check_diffuse_fraction`.

    Raises
    ------
    ValueError
        For directions outside the table.
    """
    dataset = table.dataset
    allowed = f"with {' or '.join(MIXED_QUANTITIES)}"
    hint = "quantities under isotropic light alone have no beam"
    names = find_variables(dataset, MIXED_QUANTITIES, allowed, hint)
    directions = list_directions(center, field_of_view_deg)
    for axis in dict.fromkeys(axis for name in names for axis in list_view_axes(name)):
        nodes = dataset[axis].values
        check_within_axis(axis, nodes, center[axis])
        inside = snap_to_limits([angles[axis] for angles, _ in directions], nodes[0], nodes[-1])
        if inside.min() < nodes[0] or inside.max() > nodes[-1]:
            allowed = f"within the {axis} of the table, {nodes[0]:g} to {nodes[-1]:g}"
            hint = f"around polar_deg = {center[POLAR]:g}, azimuth_deg = {center[AZIMUTH]:g}"
            raise invalid("field_of_view_deg", field_of_view_deg, allowed, hint)

    def estimate(source: Table) -> dict[str, Estimate]:
        direct = {name: _average(source, name, directions) for name in names}
        if not diffuse_fraction.any():
            return direct
        diffuse = {name: _average(source, DIFFUSE_PREFIX + name, directions) for name in names}
        dims = ("wavelength",) * diffuse_fraction.ndim
        return _mix(direct, diffuse, xr.DataArray(diffuse_fraction, dims=dims))

    variables: dict[str, Any] = {}
    for name, (value, error) in estimate(table).items():
        dims = tuple(str(dim) for dim in dataset[name].dims if dim not in VIEW_AXES)
        values, errors = (one.transpose(*dims).values for one in (value, error))
        variables |= make_variable(name, dims, values, errors, LABELS[name])
    attributes = {
        **center,
        "field_of_view_deg": field_of_view_deg,
        "diffuse_fraction": diffuse_fraction,
    }
    coordinates = {name: dataset[name] for name in table.axes if name not in VIEW_AXES}
    selected = xr.Dataset(variables, coordinates, dataset.attrs | attributes)
    for axis, part in table.comparisons.items():
        if axis not in VIEW_AXES and all(name in part for name in names):
            # Positions between nodes of other axes, in the same direction and under the same sky.
            # Quantities under isotropic light do not depend on the incidence of beams.
            for name in names if diffuse_fraction.any() else ():
                diffuse = dataset[DIFFUSE_PREFIX + name]
                if diffuse.name not in part:
                    at = {d: part[d] for d in diffuse.dims if d != "wavelength"}
                    part = part.assign({diffuse.name: load_selection(diffuse.sel(at))})
            exact = part.assign({f"{name}_stderr": 0.0 * part[name] for name in part.data_vars})
            compared = xr.Dataset({
                name: value.assign_attrs(long_name=LABELS[name])
                for name, (value, _) in estimate(type(table)(exact)).items()
            })  # fmt: skip
            selected = selected.merge(rename_comparison(compared, axis))
    return selected


def _average(
    table: Table, name: str, directions: list[tuple[Mapping[str, float], float]]
) -> Estimate:
    """Return a quantity of a table, averaged over directions where it depends on these."""
    dataset, axes = table.dataset, list_view_axes(name)
    if not axes:
        return load_selection(dataset[name]), load_selection(dataset[f"{name}_stderr"])
    total: Any = 0.0
    # Errors of neighbouring directions are treated as fully correlated.
    for angles, weight in directions:
        located = LocatedQuantity(table, name, {axis: angles[axis] for axis in axes})
        values = located.read(name)
        value, stderr = located.combine(values), located.read(f"{name}_stderr")
        error = combine_axis_errors(located.estimate_errors(values), value)
        estimate = np.stack([value, np.hypot(located.combine_errors(stderr), error)])
        total = total + weight * estimate
    dims = [*located.kept, "wavelength"]
    coordinates = {dim: dataset[dim] for dim in dims}
    mean, mean_error = (xr.DataArray(one, coordinates, dims) for one in total)
    return mean, mean_error


def _mix(
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
