"""Look-up tables: opening, interpolation, derivatives and export."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.core.atomic import atomic_write
from splits.core.escaping import escape_cells
from splits.core.keywords import declare_function
from splits.core.validation import expand_path, invalid, key_prefix
from splits.illumination.bands import Bands
from splits.io.netcdf import load, open_lazily
from splits.tables.assembly import MAX_BYTES_IN_MEMORY
from splits.tables.axes import (
    ALONG,
    AZIMUTH,
    POLAR,
    VIEW_AXES,
    check_axis_values,
    check_complete,
    list_axes,
    list_quantities,
    sort_axes,
)
from splits.tables.conversions import convert_to_eradiate, convert_to_isofit
from splits.tables.table_interpolation import (
    LocatedQuantity,
    TableInterpolation,
    average_bands,
    differentiate_table,
    estimate_interpolation_errors,
    interpolate_table,
)
from splits.tables.view_selection import (
    VIEW_POLAR,
    FieldOfView,
    ViewAzimuth,
    ViewPolar,
    ViewRequest,
    check_view_azimuth,
    describe_table,
    select_view,
)


def write_csv(dataset: xr.Dataset, path: str | Path) -> None:
    """Write a table as CSV, with one row per wavelength and point and the axes as columns.

    All quantities of a table of directions are in the same file.  A quantity that does not depend
    on an axis, such as ``reflectance`` on the angles of view, is repeated along this axis.  Text
    that a spreadsheet would evaluate as a formula gets an apostrophe in front.

    Parameters
    ----------
    dataset : xarray.Dataset
        Result of `splits.build_table`; deviations by batch and values between nodes are omitted.
    path : path
        Output file, written atomically.
    """
    names = [
        str(name)
        for name, v in dataset.data_vars.items()
        if "batch" not in v.dims and ALONG not in str(name)
    ]
    by_number_of_axes = sorted(names, key=lambda name: -dataset[name].ndim)
    dims = [str(dim) for name in by_number_of_axes for dim in dataset[name].dims]
    axes = [*dict.fromkeys(dim for dim in dims if dim != "wavelength"), "wavelength"]
    with atomic_write(path) as temporary:
        for number in range(dataset.sizes[axes[0]]):
            # One slice at a time: all rows together need many times the memory of the table.
            frame = dataset[names].isel({axes[0]: [number]}).to_dataframe(dim_order=axes)
            rows = escape_cells(frame.reset_index()[[*axes, *names]])
            rows.to_csv(temporary, mode="a", header=number == 0, index=False, float_format="%.6g")


class Table:
    """Look-up table of spectra over a grid of parameters.

    Parameters
    ----------
    dataset : xarray.Dataset
        Result of `splits.build_table` or a part of it, with axes in any order.

    Attributes
    ----------
    dataset : xarray.Dataset
        Table with ascending numeric axes and the wavelength as the last axis.
    interpolation : TableInterpolation
        Interpolation of its quantities.

    Raises
    ------
    ValueError
        If the dataset is not a table, or values or coordinates are missing.
    """

    @declare_function
    def __init__(self, dataset: xr.Dataset) -> None:
        self.dataset = sort_axes(dataset)
        if self.dataset.nbytes <= MAX_BYTES_IN_MEMORY:
            check_complete(self.dataset)
        self.interpolation = TableInterpolation(self.dataset)

    def __repr__(self) -> str:
        """Return a summary of the table: one line per axis, and the direction of observation."""
        return describe_table(self.dataset)

    @property
    def quantities(self) -> list[str]:
        """Quantities of the table, without standard errors."""
        return list_quantities(self.dataset)

    @property
    def axes(self) -> list[str]:
        """Axes of the table, the wavelength last."""
        return list_axes(self.dataset)

    @property
    def has_views(self) -> bool:
        """Whether directions of observation are axes of the table."""
        return POLAR in self.axes

    @property
    def has_direction(self) -> bool:
        """Whether the table holds distributions over directions, or their values in one."""
        return self.interpolation.has_direction

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
        request = ViewRequest.from_arguments(
            self.dataset, polar_deg, azimuth_deg, field_of_view_deg, diffuse_fraction
        )
        return Table(select_view(self.interpolation, request))

    def _complete_view(self, at: Mapping[str, Any]) -> dict[str, Any]:
        """Return positions with the direction of observation of a table that has directions."""
        if not self.has_views:
            return dict(at)
        at = check_axis_values(at, self.axes)
        polar, azimuth = self._get_direction(at)
        polar = VIEW_POLAR.check_number(POLAR, polar)
        azimuth = None if azimuth is None else check_view_azimuth(AZIMUTH, azimuth)
        request = ViewRequest.from_arguments(self.dataset, polar, azimuth)
        for name in VIEW_AXES:
            if name in self.axes:
                request.check_within_table(name, self.dataset[name].values)
        return at | dict(zip(VIEW_AXES, (request.polar, request.azimuth), strict=True))

    def _get_direction(self, at: Mapping[str, Any], prefix: str = "") -> tuple[Any, Any]:
        """Return the direction among positions; an axis of a single polar angle may be omitted."""
        polar, nodes = at.get(POLAR), self.dataset[POLAR].values
        if polar is None and nodes.size > 1:
            hint = "an axis of the table" + (" that is not retrieved" if prefix else "")
            raise invalid(f"{prefix}{POLAR}", None, "given", hint)
        return nodes[0] if polar is None else polar, at.get(AZIMUTH)

    def fix_view(self, at: Mapping[str, Any], prefix: str = "") -> tuple[Table, dict[str, Any]]:
        """Return the table for the direction among positions on axes, and the other positions.

        Names in messages begin with the prefix.  Axes of a single angle may be omitted.
        """
        at = check_axis_values(at, self.axes, prefix)
        direction = self._get_direction(at, prefix)
        others = {name: value for name, value in at.items() if name not in VIEW_AXES}
        with key_prefix(prefix.rstrip(".")):
            return self.at_view(*direction), others

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
            the same over ``band``: means of the whole spectrum, weighted by the response.

        Raises
        ------
        ValueError
            For an unknown or missing axis, or a value outside the table.
        """
        interpolation, complete = self.interpolation, self._complete_view(at)
        found = interpolate_table(interpolation, complete)
        return (
            found if bands is None else found.assign(average_bands(interpolation, complete, bands))
        )

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
        return estimate_interpolation_errors(self.interpolation, quantity, self._complete_view(at))

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
        point = self.interpolation.complete_point(at)
        located = LocatedQuantity(self.interpolation, quantity, point)
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
        return differentiate_table(self.interpolation, names, self._complete_view(at))

    @declare_function
    def to_csv(self, path: str | Path) -> None:
        """Write the table as CSV; see `splits.tables.table.write_csv`."""
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


@declare_function
def open_table(path: str | Path) -> Table:
    """Open a table from a netCDF file; values of a large table are read on access.

    Parameters
    ----------
    path : path
        File written by `splits.save` or by the workflow.

    Returns
    -------
    Table

    Raises
    ------
    ValueError
        If the file is damaged or does not hold a table.
    """
    hint = "splits.Table(…) takes a dataset" if isinstance(path, xr.Dataset) else ""
    path = expand_path(path, hint=hint)
    is_small = path.stat().st_size <= 1.2 * MAX_BYTES_IN_MEMORY
    return Table(load(path) if is_small else open_lazily(path))
