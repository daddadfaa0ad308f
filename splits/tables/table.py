"""Look-up tables: opening, interpolation, derivatives and export."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from os import PathLike
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import as_1d_array
from splits.core.keywords import declare_function
from splits.core.uncertainty import make_variable
from splits.core.validation import (
    check_choice,
    expand_path,
    invalid,
    key_prefix,
    snap_to_limits,
    unknown_key,
)
from splits.illumination.bands import Bands, SpectralOperator, check_bands
from splits.io.netcdf import load, open_lazily, to_netcdf_attributes
from splits.media.parameters import get_derivative_unit
from splits.tables.axes import (
    AZIMUTH,
    DELAY,
    DIFFUSE_PREFIX,
    MIXED_QUANTITIES,
    POLAR,
    VIEW_AXES,
    VIEW_QUANTITIES,
    check_axis_values,
    check_complete,
    find_variables,
    list_axes,
    list_quantities,
    list_view_axes,
    load_selection,
    sort_axes,
)
from splits.tables.comparison import extract_comparisons, rename_comparison
from splits.tables.conversions import convert_to_eradiate, convert_to_isofit, write_csv
from splits.tables.interpolation import AxisInterpolation, check_within_axis, transform_axis
from splits.tables.located_quantity import (
    LocatedQuantity,
    combine_axis_errors,
    interpolate_wavelengths,
    scale_axis_errors,
    stack_axis_errors,
)
from splits.tables.views import (
    VIEW_POLAR,
    Estimate,
    FieldOfView,
    ViewAzimuth,
    ViewPolar,
    check_diffuse_fraction,
    check_view_azimuth,
    choose_direction,
    list_directions,
    mix_light,
)

MAX_BYTES_IN_MEMORY = 2**28
"""Largest size of a table that is assembled in memory or read into it."""


class Table:
    """Look-up table over a grid of parameters: spectra, or returns of a pulse of light.

    Parameters
    ----------
    dataset : xarray.Dataset or path
        Dataset of a table or a part of it, with axes in any order; or a netCDF file of it, written
        by `splits.save` or by the workflow.  Values of a large file are read on access.

    Attributes
    ----------
    dataset : xarray.Dataset
        Table with ascending numeric axes and the wavelength as the last axis.
    axes : list of str
        Axes of the table, the wavelength last.
    quantities : list of str
        Quantities of the table, without standard errors.

    Raises
    ------
    ValueError
        If the dataset is not a table, values or coordinates are missing, or a file is damaged.
    """

    @declare_function
    def __init__(self, dataset: Any) -> None:
        if isinstance(dataset, str | PathLike):
            path = expand_path(dataset)
            is_small = path.stat().st_size <= 1.2 * MAX_BYTES_IN_MEMORY
            dataset = load(path) if is_small else open_lazily(path)
        self.dataset = sort_axes(dataset)
        self.axes, self.quantities = list_axes(self.dataset), list_quantities(self.dataset)
        if self.dataset.nbytes <= MAX_BYTES_IN_MEMORY:
            check_complete(self.dataset)
        self._prepared: dict[str, dict[str, AxisInterpolation]] = {}

    def __repr__(self) -> str:
        """Return a summary of the table: one line per axis, and the direction of observation."""
        dataset, lines = self.dataset, [f"Table of {', '.join(self.quantities)}"]
        for name in [*self.axes, *({DELAY} & set(map(str, dataset.dims)))]:
            values = dataset[name].values
            span = f"{values[0]} to {values[-1]}" if values.dtype.kind == "f" else ", ".join(values)
            lines.append(f"{name}: {values.size} from {span}")
        if POLAR in dataset.attrs:
            texts = []
            for name in (*VIEW_AXES, "field_of_view_deg", "diffuse_fraction"):
                values = np.ravel(dataset.attrs.get(name, []))
                if values.size:
                    last = f" to {values.max():g}" if np.ptp(values) > 0.0 else ""
                    texts.append(f"{name} {values.min():g}{last}")
            lines.append(f"direction: {', '.join(texts)}")
        return "\n  ".join(lines)

    def _repr_html_(self) -> str:
        """Return the dataset of the table for notebooks."""
        return self.dataset._repr_html_()

    @property
    def attrs(self) -> dict[str, Any]:
        """Attributes of the dataset: the solver, the error reached, and all inputs."""
        return self.dataset.attrs

    @property
    def has_views(self) -> bool:
        """Whether directions of observation are axes of the table."""
        return POLAR in self.axes

    @property
    def has_direction(self) -> bool:
        """Whether the table holds distributions over directions, or their values in one."""
        return any(name in VIEW_QUANTITIES for name in self.quantities)

    @cached_property
    def comparisons(self) -> dict[str, xr.Dataset]:
        """Tables with positions between the nodes of an axis, by axis."""
        return extract_comparisons(self.dataset)

    @cached_property
    def point_quantities(self) -> list[str]:
        """Quantities at a point: with directions, those under the beam; all without gaps."""
        return [
            name for name in self.quantities
            if (name in MIXED_QUANTITIES or not self.has_views)
            and not (self.has_delays and self.dataset[name].isnull().any())
        ]  # fmt: skip

    @cached_property
    def has_delays(self) -> bool:
        """Whether the table holds returns of a pulse."""
        return DELAY in self.dataset.dims

    def prepare(self, quantity: str) -> dict[str, AxisInterpolation]:
        """Return the interpolation of a quantity along each of its numeric axes."""
        if quantity not in self._prepared:
            variable = self.dataset[quantity]
            names = [n for n in self.axes[:-1] if n in variable.dims]
            numeric = {
                n: self.dataset[n].values for n in names if self.dataset[n].dtype.kind == "f"
            }
            transforms = {name: transform_axis(name, nodes)[0] for name, nodes in numeric.items()}
            prepared = {}
            for name, nodes in numeric.items():
                comparison = self.comparisons.get(name, xr.Dataset()).get(quantity)
                if comparison is not None:
                    others = [other for other in names if other != name]
                    comparison = comparison.transpose(name, *others, "wavelength")
                prepared[name] = AxisInterpolation(
                    name, nodes, variable.sizes["wavelength"],
                    has_direction=self.has_direction, comparison=comparison,
                    other_transforms=transforms,
                )  # fmt: skip
            self._prepared[quantity] = prepared
        return self._prepared[quantity]

    def locate(
        self, quantity: str, point: Mapping[str, Any], slopes_of: Sequence[str] = ()
    ) -> LocatedQuantity:
        """Return a quantity at a validated point on some or all axes."""
        prepared = self.prepare(quantity)
        return LocatedQuantity(self.dataset, prepared, quantity, point, slopes_of)

    def complete_point(self, at: Mapping[str, Any]) -> dict[str, Any]:
        """Return the validated position on every axis; axes of one node may be left out."""
        at = check_axis_values(at, self.axes[:-1])
        point: dict[str, Any] = {}
        for name in self.axes[:-1]:
            nodes = self.dataset.variables[name].values
            value = self._get_position(at, name)
            if nodes.dtype.kind == "f":
                point[name] = check_within_axis(name, nodes, value)
            else:
                point[name] = check_choice(name, str(value), nodes.tolist())
        return point

    def _get_position(self, at: Mapping[str, Any], name: str, prefix: str = "") -> Any:
        """Return the position on an axis; it may be omitted on an axis of a single node."""
        nodes, value = self.dataset.variables[name].values, at.get(name)
        if value is None and nodes.size > 1:
            hint = "an axis of the table" + (" that is not retrieved" if prefix else "")
            raise invalid(f"{prefix}{name}", None, "given", hint)
        return nodes[0] if value is None else value

    def _complete_view(self, at: Mapping[str, Any]) -> dict[str, Any]:
        """Return positions with the direction of observation of a table that has directions."""
        if not self.has_views:
            return dict(at)
        at = check_axis_values(at, self.axes)
        polar = VIEW_POLAR.check_number(POLAR, self._get_position(at, POLAR))
        azimuth = at.get(AZIMUTH)
        azimuth = None if azimuth is None else check_view_azimuth(AZIMUTH, azimuth)
        direction = choose_direction(self.dataset, polar, azimuth)
        for name in VIEW_AXES:
            if name in self.axes:
                check_within_axis(name, self.dataset[name].values, direction[name])
        return at | direction

    @declare_function
    def at_view(
        self,
        polar_deg: ViewPolar,
        azimuth_deg: ViewAzimuth | None = None,
        *,
        field_of_view_deg: FieldOfView = 0.0,
        diffuse_fraction: Any = 0.0,
    ) -> Table:
        """Return the table for one direction of observation.

        Parameters
        ----------
        polar_deg : float
            Angle from the normal (degrees), within the table.
        azimuth_deg : float, optional
            Angle from the direction in which the beam travels (degrees), 0 to below 360; 180 is
            the side of the sun.  It has no effect at the normal, and for a beam at the normal.
        field_of_view_deg : float
            Full angle of a conical field of view within the table, 0 to 60 degrees.
        diffuse_fraction : float or array_like, shape (wavelengths,)
            Fraction of the irradiance that is isotropic, 0 to 1.  Above 0 it needs the quantities
            under isotropic light, see `splits.build_table`.

        Returns
        -------
        Table
            ``reflectance``, ``reflectance_factor`` and ``anisotropy_factor`` over the remaining
            axes, as far as the table holds them.  The reflectance factor is bidirectional,
            hemispherical-directional (with isotropic light) or (hemispherical-)conical.  Errors
            include those of interpolation.

        Raises
        ------
        ValueError
            For a table without directions, or a direction outside it.

        References
        ----------
        Schaepman-Strub et al. (2006), Remote Sensing of Environment 103, 27-42.
        """
        dataset, center = self.dataset, choose_direction(self.dataset, polar_deg, azimuth_deg)
        fraction = check_diffuse_fraction(dataset, diffuse_fraction)
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
                hint = f"around polar_deg = {polar_deg:g}, azimuth_deg = {center[AZIMUTH]:g}"
                raise invalid("field_of_view_deg", field_of_view_deg, allowed, hint)
        variables: dict[str, Any] = {}
        for name, (value, error) in self._average_views(names, directions, fraction).items():
            dims = tuple(str(dim) for dim in dataset[name].dims if dim not in VIEW_AXES)
            values, errors = (one.transpose(*dims).values for one in (value, error))
            variables |= make_variable(name, dims, values, errors, name.replace("_", " "))
        attributes = {
            **center, "field_of_view_deg": field_of_view_deg, "diffuse_fraction": fraction
        }  # fmt: skip
        coordinates = {name: dataset[name] for name in self.axes if name not in VIEW_AXES}
        selected = xr.Dataset(variables, coordinates, dataset.attrs | attributes)
        for axis, part in self.comparisons.items():
            if axis not in VIEW_AXES and all(name in part for name in names):
                # Positions between nodes of other axes, in the same direction and under the same
                # sky.  Quantities under isotropic light do not depend on the incidence of beams.
                for name in names if fraction.any() else ():
                    diffuse = dataset[DIFFUSE_PREFIX + name]
                    if diffuse.name not in part:
                        at = {d: part[d] for d in diffuse.dims if d != "wavelength"}
                        part = part.assign({diffuse.name: load_selection(diffuse.sel(at))})
                exact = part.assign({f"{name}_stderr": 0.0 * part[name] for name in part.data_vars})
                found = Table(exact)._average_views(names, directions, fraction)
                compared = xr.Dataset({
                    name: value.assign_attrs(long_name=name.replace("_", " "))
                    for name, (value, _) in found.items()
                })  # fmt: skip
                selected = selected.merge(rename_comparison(compared, axis))
        return Table(selected)

    def _average_views(
        self,
        names: Sequence[str],
        directions: Sequence[tuple[Mapping[str, float], float]],
        diffuse_fraction: np.ndarray,
    ) -> dict[str, Estimate]:
        """Return quantities averaged over directions, under a beam and isotropic light."""

        def average(name: str) -> Estimate:
            axes = list_view_axes(name)
            if not axes:
                mean, mean_error = self.dataset[name], self.dataset[f"{name}_stderr"]
                return load_selection(mean), load_selection(mean_error)
            total: Any = 0.0
            # Errors of neighbouring directions are treated as fully correlated.
            for angles, weight in directions:
                located = self.locate(name, {axis: angles[axis] for axis in axes})
                values = located.read(name)
                value, stderr = located.combine(values), located.read(f"{name}_stderr")
                error = combine_axis_errors(located.estimate_errors(values), value)
                estimate = np.stack([value, np.hypot(located.combine_errors(stderr), error)])
                total = total + weight * estimate
            dims = [*located.kept, "wavelength"]
            coordinates = {dim: self.dataset[dim] for dim in dims}
            mean, mean_error = (xr.DataArray(one, coordinates, dims) for one in total)
            return mean, mean_error

        direct = {name: average(name) for name in names}
        if not diffuse_fraction.any():
            return direct
        diffuse = {name: average(DIFFUSE_PREFIX + name) for name in names}
        dims = ("wavelength",) * diffuse_fraction.ndim
        return mix_light(direct, diffuse, xr.DataArray(diffuse_fraction, dims=dims))

    def fix_view(self, at: Mapping[str, Any], prefix: str = "") -> tuple[Table, dict[str, Any]]:
        """Return the table for the direction among positions on axes, and the other positions.

        Names in messages begin with the prefix.  Axes of a single angle may be omitted.
        """
        at = check_axis_values(at, self.axes, prefix)
        polar = self._get_position(at, POLAR, prefix)
        others = {name: value for name, value in at.items() if name not in VIEW_AXES}
        with key_prefix(prefix.rstrip(".")):
            return self.at_view(polar, at.get(AZIMUTH)), others

    @declare_function
    def interp(self, *, bands: Bands = None, **at: Any) -> xr.Dataset:
        """Interpolate spectra between the nodes of the table.

        Parameters
        ----------
        bands : mapping or str, optional
            Bands within the wavelengths of the table, as for `splits.albedo`.
        **at
            Position on each axis: a number within the axis, or one of its text values.
            ``wavelength`` may be a sequence of numbers; all wavelengths are returned if it is
            omitted.  Axes of a single value may be omitted.  ``sza`` is short for
            ``incidence_deg``.  ``polar_deg`` and ``azimuth_deg`` as for `at_view`.

        Returns
        -------
        xarray.Dataset
            Each quantity over ``wavelength``, with its standard error ``…_stderr``: the error of
            the nodes and the interpolation error, in quadrature.  The error of the nodes is the
            larger of those for fully correlated and for independent nodes.
            ``…_interpolation_error`` is the interpolation error alone.  With bands, ``band_…`` are
            the same over ``band``: means of the whole spectrum, weighted by the response.  Errors
            of nodes are fully correlated within a band.  The interpolation error along an axis is
            fully correlated between all wavelengths, with its relative signs.  A table of returns
            has ``return_rate`` also over ``delay_s``.

        Raises
        ------
        ValueError
            For an unknown or missing axis, or a value outside the table; for wavelengths or bands
            of a table of returns, whose wavelengths have rays of their own.
        """
        given = check_axis_values(self._complete_view(at), self.axes)
        nodes = targets = self.dataset.wavelength.values
        if self.has_delays and (bands is not None or "wavelength" in given):
            name = "bands" if bands is not None else "wavelength"
            hint = "each wavelength has rays of its own: select from the result"
            raise invalid(name, given.get(name, bands), "left out for a table of returns", hint)
        if "wavelength" in given:
            requested = as_1d_array("wavelength", given.pop("wavelength"), "numbers in nanometres")
            targets = np.array([check_within_axis("wavelength", nodes, one) for one in requested])
        point = self.complete_point(given)
        named = {} if bands is None else check_bands(bands)
        if named:
            matrix, error_weights = SpectralOperator.from_bands(named, nodes)
        variables: dict[str, Any] = {}
        means: dict[str, Any] = {}
        for quantity in self.point_quantities:
            located = self.locate(quantity, point)
            values, node_stderr = located.read(quantity), located.read(f"{quantity}_stderr")
            value, stderr = located.combine(values), located.combine_errors(node_stderr)
            errors = located.estimate_errors(values)
            error = combine_axis_errors(errors, value)
            attributes = self.dataset[quantity].attrs
            label, units = str(attributes.get("long_name", quantity)), attributes.get("units", "1")
            if named:
                rows = stack_axis_errors(errors, value.shape)
                squares = np.hypot(stderr, error) ** 2 - error**2
                band_errors = np.vstack([
                    scale_axis_errors(rows) @ matrix.T, error_weights @ value
                ])  # fmt: skip
                means |= _make_variables(
                    f"band_{quantity}", ("band",), matrix @ value,
                    matrix @ np.sqrt(np.maximum(squares, 0.0)),
                    np.sqrt((band_errors**2).sum(axis=0)), f"{label} over a band",
                )  # fmt: skip
            if not np.array_equal(targets, nodes):
                value, stderr, error = interpolate_wavelengths(value, stderr, error, nodes, targets)
            variables |= _make_variables(
                quantity, located.trailing_dims, value, stderr, error, label, units
            )
        coordinates = {"wavelength": ("wavelength", targets, self.dataset.wavelength.attrs)}
        found = xr.Dataset(variables, coordinates, to_netcdf_attributes(given))
        if self.has_delays:
            found = found.assign_coords(self.dataset[[DELAY]].coords)
        return found.assign(xr.Dataset(means, {"band": list(named)})) if named else found

    @declare_function
    def interpolation_errors(self, quantity: str, **at: Any) -> np.ndarray:
        """Return the spectral shape of the interpolation error along each axis.

        The error of an axis is fully correlated between wavelengths; its overall sign is unknown.

        Parameters
        ----------
        quantity : str
        **at
            As for `interp`, without a wavelength.

        Returns
        -------
        float, shape (axes, wavelengths)
            Error estimates, with relative signs along the spectrum.
        """
        located = self.locate(quantity, self.complete_point(self._complete_view(at)))
        values = located.read(quantity)
        return stack_axis_errors(
            located.estimate_errors(values), values.shape[len(located.names) :]
        )

    @declare_function
    def deviations(self, quantity: str, **at: Any) -> np.ndarray:
        """Return the interpolated deviations by batch of rays of a table with covariance.

        Parameters
        ----------
        quantity : str
        **at
            As for `interp`, without a wavelength.

        Returns
        -------
        float, shape (batches, wavelengths)
            Deviations; sums of products over batches are covariances.

        Raises
        ------
        ValueError
            For a table made without ``covariance=True``.
        """
        name = f"{quantity}_batches"
        if name not in self.dataset:
            raise invalid("table", quantity, "a table made with covariance=True")
        located = self.locate(quantity, self.complete_point(at))
        return located.combine(located.read(name))

    @declare_function
    def derivatives(self, names: Sequence[str], **at: Any) -> xr.Dataset:
        """Return derivatives with respect to the parameters of axes.

        Parameters
        ----------
        names : sequence of str
            Numeric axes.
        **at
            As for `interp`, without a wavelength.

        Returns
        -------
        xarray.Dataset
            ``reflectance_jacobian`` and ``…_stderr`` over ``parameter`` and ``wavelength``, per
            unit of the parameter.  The standard error includes the interpolation error.  Unless
            the table was made with ``covariance=True``, errors of the nodes are treated as
            independent, which overestimates the error of nodes that share paths.

        Raises
        ------
        ValueError
            As for `interp`, and at the singularity of an axis with a square-root transform.
        """
        at = check_axis_values(self._complete_view(at), self.axes[:-1])
        axes = [n for n in self.axes[:-1] if self.dataset[n].dtype.kind == "f"]
        is_list = isinstance(names, Sequence) and not isinstance(names, str)
        if not is_list or not 0 < len(names) == len(set(names)):
            raise invalid("names", names, f"a list of different names: {', '.join(axes)}")
        for name in names:
            if name not in axes:
                raise unknown_key(f"names.{name}", axes)
            if self.dataset[name].size < 2:
                allowed = "an axis of at least two nodes"
                raise invalid(f"derivatives ({name})", self.dataset[name].size, allowed)
        point = self.complete_point(at)
        variables: dict[str, Any] = {}
        for quantity in self.point_quantities:
            located = self.locate(quantity, point, names)
            values, errors = np.stack([located.differentiate(name) for name in names], axis=1)
            unit = self.dataset[quantity].attrs.get("units", "1")
            label = f"derivative of {quantity} with respect to the parameter, per unit of it"
            for suffix, rows, long_name in (
                ("", values, label), ("_stderr", errors, f"standard error of the {label}"),
            ):  # fmt: skip
                variables[f"{quantity}_jacobian{suffix}"] = (
                    ("parameter", *located.trailing_dims), rows,
                    {"long_name": long_name, "units": unit},
                )  # fmt: skip
        units = [get_derivative_unit(name) for name in names]
        coordinates = {
            "parameter": ("parameter", list(names), {"long_name": "parameter"}),
            "parameter_unit": ("parameter", units, {"long_name": "unit of the derivative"}),
            "wavelength": (
                "wavelength", self.dataset.wavelength.values, self.dataset.wavelength.attrs
            ),
        }  # fmt: skip
        if self.has_delays:
            coordinates[DELAY] = (DELAY, self.dataset[DELAY].values, self.dataset[DELAY].attrs)
        return xr.Dataset(variables, coordinates, to_netcdf_attributes(at))

    @declare_function
    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write the table as CSV; see `splits.tables.conversions.write_csv`."""
        write_csv(self.dataset, path)

    @declare_function
    def to_isofit(self, **at: Any) -> xr.Dataset:
        """Convert the table for isofit; see `splits.tables.conversions.convert_to_isofit`."""
        return convert_to_isofit(self.dataset, **at)

    @declare_function
    def to_eradiate(
        self,
        *,
        wavelength: float | None = None,
        n_cosines: int = 51,
        n_azimuths: int = 72,
        **at: Any,
    ) -> xr.Dataset:
        """Convert the table for eradiate; see `splits.tables.conversions.convert_to_eradiate`."""
        return convert_to_eradiate(
            self.dataset, wavelength=wavelength, n_cosines=n_cosines, n_azimuths=n_azimuths, **at
        )


def _make_variables(
    name: str, dims: tuple[str, ...], value: np.ndarray, stderr: np.ndarray, error: np.ndarray,
    label: str, units: str = "1",
) -> dict[str, Any]:  # fmt: skip
    """Return the variables of an interpolated quantity and its errors."""
    rows = (
        ("", value, label),
        ("_stderr", np.hypot(stderr, error), f"standard error of {label}"),
        ("_interpolation_error", error, f"error of interpolation of {label}"),
    )
    return {
        name + suffix: (dims, row, {"long_name": long_name, "units": units})
        for suffix, row, long_name in rows
    }
