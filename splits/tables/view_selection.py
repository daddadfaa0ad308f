"""Part of a table for one direction of observation, a field of view, and a sky.

Values of directions between those of a table are interpolated.  A field of view averages them over
a cone, with the cosine of the polar angle as weight (Schaepman-Strub et al. 2006, Remote Sensing of
Environment 103, 27).  A part of the light may be isotropic.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, NamedTuple

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
    list_quantities,
    list_view_axes,
    load_selection,
)
from splits.tables.comparison import rename_comparison
from splits.tables.interpolation import check_within_axis
from splits.tables.table_interpolation import (
    LocatedQuantity,
    TableInterpolation,
    combine_axis_errors,
)

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


class ViewRequest(NamedTuple):
    """Direction of observation, and what else determines a reflectance factor.

    Attributes
    ----------
    polar, azimuth : float
        Degrees; azimuths from 0 to 180.
    field_of_view_deg : float
        Full angle of the cone.
    diffuse_fraction : float, shape () or (wavelengths,)
        Fraction of the irradiance that is isotropic.
    """

    polar: float
    azimuth: float
    field_of_view_deg: float
    diffuse_fraction: np.ndarray

    @classmethod
    def from_arguments(
        cls, dataset: xr.Dataset, polar_deg: float, azimuth_deg: float | None,
        field_of_view_deg: float = 0.0, diffuse_fraction: Any = 0.0,
    ) -> ViewRequest:  # fmt: skip
        """Return the request of `splits.Table.at_view`, after checking it with the table."""
        if POLAR not in list_axes(dataset):
            hint = f"axes {', '.join(list_axes(dataset))}"
            raise invalid("polar_deg", polar_deg, "left out for a table without directions", hint)
        azimuth = _choose_azimuth(dataset, polar_deg, azimuth_deg)
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
        return cls(polar_deg, float(fold_azimuths(azimuth)), field_of_view_deg, fraction)

    def list_directions(self) -> list[tuple[dict[str, float], float]]:
        """Return the angles of directions in the field of view, with weights of a sum of 1."""
        if self.field_of_view_deg == 0.0:
            return [({POLAR: self.polar, AZIMUTH: self.azimuth}, 1.0)]
        nodes, weights = np.polynomial.legendre.leggauss(N_RINGS)
        half_angle = np.radians(0.5 * self.field_of_view_deg)
        cosine = 1.0 - 0.5 * (1.0 - np.cos(half_angle)) * (1.0 + nodes)
        turn = 2.0 * np.pi * (np.arange(N_RING_DIRECTIONS) + 0.5) / N_RING_DIRECTIONS
        sine = np.sqrt(1.0 - cosine**2)[:, np.newaxis]
        x, y = sine * np.cos(turn), sine * np.sin(turn)
        z = np.broadcast_to(cosine[:, np.newaxis], x.shape)
        tilt, azimuth = np.radians([self.polar, self.azimuth])
        x, z = x * np.cos(tilt) + z * np.sin(tilt), z * np.cos(tilt) - x * np.sin(tilt)
        if (z <= 0.0).any():
            allowed = f"below {2.0 * (90.0 - self.polar):g} for polar_deg = {self.polar:g}"
            raise invalid("field_of_view_deg", self.field_of_view_deg, allowed)
        angles = np.degrees([np.arccos(z), azimuth + np.arctan2(y, x)]).reshape(2, -1)
        fractions = np.repeat(weights, N_RING_DIRECTIONS) * z.ravel()
        fractions = fractions / fractions.sum()
        return [
            ({POLAR: polar, AZIMUTH: float(fold_azimuths(azimuth))}, fraction)
            for polar, azimuth, fraction in zip(*angles.tolist(), fractions.tolist(), strict=True)
        ]

    def check_within_table(self, name: str, nodes: np.ndarray) -> None:
        """Check that the field of view does not extend beyond the nodes of an angle.

        Raises
        ------
        ValueError
            For a centre or a direction around it outside the nodes.
        """
        center = self.polar if name == POLAR else self.azimuth
        check_within_axis(name, nodes, center)
        angles = [direction[name] for direction, _ in self.list_directions()]
        inside = snap_to_limits(angles, nodes[0], nodes[-1])
        if inside.min() < nodes[0] or inside.max() > nodes[-1]:
            allowed = f"within the {name} of the table, {nodes[0]:g} to {nodes[-1]:g}"
            hint = f"around polar_deg = {self.polar:g}, azimuth_deg = {self.azimuth:g}"
            raise invalid("field_of_view_deg", self.field_of_view_deg, allowed, hint)


def _choose_azimuth(dataset: xr.Dataset, polar: float, azimuth_deg: float | None) -> float:
    """Return the azimuth (degrees), the first of the table where it has no effect."""
    nodes = dataset[AZIMUTH].values if AZIMUTH in dataset.dims else np.zeros(1)
    incidence = np.ravel(dataset[INCIDENCE] if INCIDENCE in dataset else dataset.attrs[INCIDENCE])
    if polar == 0.0 or AZIMUTH not in dataset.dims or (incidence == 0.0).all():
        return float(nodes[0])
    if azimuth_deg is None and nodes.size > 1:
        raise invalid("azimuth_deg", None, "given", "an axis of the table")
    return float(nodes[0]) if azimuth_deg is None else azimuth_deg


def select_view(interpolation: TableInterpolation, request: ViewRequest) -> xr.Dataset:
    """Return a table of spectra for one request, with the interpolation error in its errors.

    Parameters
    ----------
    interpolation : TableInterpolation
        Interpolation of a table with directions of observation.
    request : ViewRequest

    Raises
    ------
    ValueError
        For directions outside the table.
    """
    dataset = interpolation.dataset
    allowed = f"with {' or '.join(MIXED_QUANTITIES)}"
    hint = "quantities under isotropic light alone have no beam"
    names = find_variables(dataset, MIXED_QUANTITIES, allowed, hint)
    for axis in dict.fromkeys(axis for name in names for axis in list_view_axes(name)):
        request.check_within_table(axis, dataset[axis].values)
    variables: dict[str, Any] = {}
    for name, (value, error) in _estimate(interpolation, names, request).items():
        dims = tuple(str(dim) for dim in dataset[name].dims if dim not in VIEW_AXES)
        values, errors = (one.transpose(*dims).values for one in (value, error))
        variables |= make_variable(name, dims, values, errors, LABELS[name])
    attributes = {
        "polar_deg": request.polar,
        "azimuth_deg": request.azimuth,
        "field_of_view_deg": request.field_of_view_deg,
        "diffuse_fraction": request.diffuse_fraction,
    }
    coordinates = {name: dataset[name] for name in interpolation.axes if name not in VIEW_AXES}
    coordinates["wavelength"] = dataset.wavelength
    selected = xr.Dataset(variables, coordinates, dataset.attrs | attributes)
    for axis, part in interpolation.comparisons.items():
        if axis not in VIEW_AXES and all(name in part for name in names):
            # Positions between nodes of other axes, in the same direction and under the same sky.
            # Quantities under isotropic light do not depend on the incidence of beams.
            for name in names if request.diffuse_fraction.any() else ():
                diffuse = dataset[DIFFUSE_PREFIX + name]
                if diffuse.name not in part:
                    at = {d: part[d] for d in diffuse.dims if d != "wavelength"}
                    part = part.assign({diffuse.name: load_selection(diffuse.sel(at))})
            exact = part.assign({f"{name}_stderr": 0.0 * part[name] for name in part.data_vars})
            found = _estimate(TableInterpolation(exact), names, request)
            compared = xr.Dataset({
                name: value.assign_attrs(long_name=LABELS[name])
                for name, (value, _) in found.items()
            })  # fmt: skip
            selected = selected.merge(rename_comparison(compared, axis))
    return selected


def _estimate(
    interpolation: TableInterpolation, names: list[str], request: ViewRequest
) -> dict[str, Estimate]:
    """Return the estimates of quantities for a request."""
    directions = request.list_directions()
    direct = {name: _average(interpolation, name, directions) for name in names}
    if not request.diffuse_fraction.any():
        return direct
    diffuse = {name: _average(interpolation, DIFFUSE_PREFIX + name, directions) for name in names}
    dims = ("wavelength",) * request.diffuse_fraction.ndim
    return _mix(direct, diffuse, xr.DataArray(request.diffuse_fraction, dims=dims))


def describe_table(dataset: xr.Dataset) -> str:
    """Return a summary of a table: its quantities, its axes, and its direction of observation."""
    lines = [f"Table of {', '.join(list_quantities(dataset))}"]
    for name in list_axes(dataset):
        values = dataset[name].values
        span = f"{values[0]} to {values[-1]}" if values.dtype.kind == "f" else ", ".join(values)
        lines.append(f"{name}: {values.size} from {span}")
    if POLAR in dataset.attrs:
        names = (*VIEW_AXES, "field_of_view_deg", "diffuse_fraction")
        given = {name: np.ravel(dataset.attrs[name]) for name in names if name in dataset.attrs}
        texts = [
            f"{name} {values.min():g}" + (f" to {values.max():g}" if np.ptp(values) > 0.0 else "")
            for name, values in given.items()
        ]
        lines.append(f"direction: {', '.join(texts)}")
    return "\n  ".join(lines)


Estimate = tuple[xr.DataArray, xr.DataArray]
"""Values and standard errors."""


def _average(
    interpolation: TableInterpolation, name: str, directions: list[tuple[dict[str, float], float]]
) -> Estimate:
    """Return a quantity of a table, averaged over directions where it depends on these."""
    dataset, axes = interpolation.dataset, list_view_axes(name)
    if not axes:
        return load_selection(dataset[name]), load_selection(dataset[f"{name}_stderr"])
    total: Any = 0.0
    # Errors of neighbouring directions are treated as fully correlated.
    for angles, weight in directions:
        located = LocatedQuantity(interpolation, name, {axis: angles[axis] for axis in axes})
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
