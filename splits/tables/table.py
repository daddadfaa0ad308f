"""Look-up tables: opening, interpolation, derivatives and export."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import as_1d_array
from splits.core.keywords import reject_unknown_arguments
from splits.core.paths import expand_path
from splits.core.validation import invalid, key_prefix
from splits.io.netcdf import load, open_lazily, to_netcdf_attributes
from splits.tables.axes import check_axis_values
from splits.tables.axis_order import check_complete, list_axes, load_selection, sort_axes
from splits.tables.bird import write_bird
from splits.tables.derivatives import (
    DerivativeEstimate,
    check_derivative_axes,
    compute_derivative_weights,
    differentiate,
    make_derivative_dataset,
)
from splits.tables.eradiate import convert_to_eradiate
from splits.tables.export import write_csv
from splits.tables.interpolated_spectra import (
    InterpolatedSpectra,
    compute_axis_weights,
    interpolate_first_axis,
    interpolate_wavelengths,
    make_interpolated_variables,
)
from splits.tables.interpolation import (
    InterpolationWeights,
    check_within_axis,
)
from splits.tables.isofit import convert_to_isofit
from splits.tables.spires import convert_to_spires
from splits.tables.storage import MAX_BYTES_IN_MEMORY
from splits.tables.view_selection import ViewRequest, describe_direction, select_view
from splits.tables.views import POLAR, VIEW_AXES, VIEW_QUANTITIES


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

    Raises
    ------
    ValueError
        If the dataset is not a table, or values or coordinates are missing.
    """

    @reject_unknown_arguments
    def __init__(self, dataset: xr.Dataset) -> None:
        self.dataset = sort_axes(dataset)
        if self.dataset.nbytes <= MAX_BYTES_IN_MEMORY:
            check_complete(self.dataset)

    def __repr__(self) -> str:
        """Return a summary of the table: one line per axis, and the direction of observation."""
        lines = [f"Table of {', '.join(self.quantities)}"]
        for name in self.axes:
            values = self.dataset[name].values
            span = f"{values[0]} to {values[-1]}" if values.dtype.kind == "f" else ", ".join(values)
            lines.append(f"  {name}: {values.size} from {span}")
        if self.has_direction and POLAR in self.dataset.attrs:
            lines.append(f"  direction: {describe_direction(self.dataset.attrs)}")
        return "\n".join(lines)

    @property
    def quantities(self) -> list[str]:
        """Quantities of the table, without standard errors."""
        return [str(n) for n in self.dataset.data_vars if f"{n}_stderr" in self.dataset.data_vars]

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
        return any(name in self.quantities for name in VIEW_QUANTITIES)

    @reject_unknown_arguments
    def at_view(
        self,
        polar_deg: float,
        azimuth_deg: float | None = None,
        *,
        field_of_view_deg: float = 0.0,
        diffuse_fraction: Any = 0.0,
    ) -> Table:
        """Return the table for one direction of observation.

        Parameters
        ----------
        polar_deg : float
            Angle from the normal (degrees), within the table.
        azimuth_deg : float, optional
            Angle from the direction in which the beam travels (degrees), −360 to 360; 180 is the
            side of the sun.  It has no effect at the normal, and for a beam at the normal.
        field_of_view_deg : float
            Full angle of a conical field of view, 0 to 60 degrees, which must lie within the
            table.
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
        if not self.has_views:
            hint = f"axes {', '.join(self.axes)}"
            raise invalid("polar_deg", polar_deg, "left out for a table without directions", hint)
        request = ViewRequest.from_arguments(
            self.dataset, polar_deg, azimuth_deg, field_of_view_deg, diffuse_fraction
        )
        return Table(select_view(self.dataset, request))

    def fix_view(self, at: Mapping[str, Any], prefix: str = "") -> tuple[Table, dict[str, Any]]:
        """Return the table for the direction among positions on axes, and the other positions.

        Names in messages begin with the prefix.  Axes of a single angle may be omitted.
        """
        at = check_axis_values(at, self.axes, prefix)
        view = {name: at.pop(name, None) for name in VIEW_AXES}
        nodes = self.dataset[POLAR].values
        if view[POLAR] is None and nodes.size > 1:
            raise invalid(
                f"{prefix}{POLAR}", None, "given", "an axis of the table that is not retrieved"
            )
        view[POLAR] = nodes[0] if view[POLAR] is None else view[POLAR]
        with key_prefix(prefix.rstrip(".")):
            return self.at_view(**view), at

    @reject_unknown_arguments
    def interp(self, **at: Any) -> xr.Dataset:
        """Interpolate spectra between the nodes of the table.

        Parameters
        ----------
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
            ``…_interpolation_error`` is the interpolation error alone.

        Raises
        ------
        ValueError
            For an unknown or missing axis, or a value outside the table.
        """
        if self.has_views:
            table, at = self.fix_view(at)
            return table.interp(**at)
        at = check_axis_values(at, self.axes)
        wavelengths = self.dataset.wavelength.values
        targets = wavelengths
        if "wavelength" in at:
            requested = as_1d_array("wavelength", at.pop("wavelength"), "numbers in nanometres")
            targets = np.array(
                [check_within_axis("wavelength", wavelengths, value) for value in requested]
            )
        subset, weights = self._select_stencil(at)
        spectra = [
            InterpolatedSpectra(*(subset[n].values.astype(float) for n in (q, f"{q}_stderr")))
            for q in self.quantities
        ]
        for axis_weights in weights:
            spectra = [interpolate_first_axis(spectrum, axis_weights) for spectrum in spectra]
        if not np.array_equal(targets, wavelengths):
            spectra = [
                interpolate_wavelengths(spectrum, wavelengths, targets) for spectrum in spectra
            ]
        labels = [str(self.dataset[q].attrs.get("long_name", q)) for q in self.quantities]
        wavelength = ("wavelength", targets, self.dataset.wavelength.attrs)
        variables = make_interpolated_variables(self.quantities, labels, spectra)
        return xr.Dataset(variables, {"wavelength": wavelength}, to_netcdf_attributes(at))

    @reject_unknown_arguments
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
        if self.has_views:
            table, at = self.fix_view(at)
            return table.interpolation_errors(quantity, **at)
        subset, weights = self._select_stencil(at)
        values = subset[quantity].values.astype(float)
        errors: list[list[np.ndarray]] = []
        for w in weights:
            errors = [[np.tensordot(w.weights, row[w.nodes], 1) for row in rows] for rows in errors]
            errors.append([np.tensordot(row, values, 1) for row in w.error_weights])
            values = np.tensordot(w.weights, values[w.nodes], 1)
        # The largest of the estimates from different validation nodes.
        zero = np.zeros_like(values)
        largest = [max(rows, key=lambda r: float((r**2).sum()), default=zero) for rows in errors]
        return np.array(largest).reshape(-1, values.size)

    @reject_unknown_arguments
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
        subset, weights = self._select_stencil(at, [name])
        values = subset[name].transpose(*self.axes[:-1], "batch", "wavelength").values.astype(float)
        for w in weights:
            values = np.tensordot(w.weights, values[w.nodes], 1)
        return values

    @reject_unknown_arguments
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
        if self.has_views:
            table, at = self.fix_view(at)
            return table.derivatives(names, **at)
        axes = self.axes[:-1]
        at = check_axis_values(at, axes)
        numeric_axes = [n for n in axes if self.dataset[n].dtype.kind == "f"]
        selected = check_derivative_axes(names, numeric_axes)
        batch_variables = [
            f"{q}_batches" for q in self.quantities if f"{q}_batches" in self.dataset
        ]
        subset, weights = self._select_stencil(at, self._list_variables() + batch_variables)
        estimates: dict[str, list[DerivativeEstimate]] = {q: [] for q in self.quantities}
        for name in selected:
            axis, nodes = axes.index(name), self.dataset[name].values
            stencil = np.searchsorted(nodes, subset[name].values[weights[axis].nodes])
            derivative_weights = compute_derivative_weights(
                name, nodes, stencil, check_within_axis(name, nodes, at.get(name, nodes[0])),
                has_direction=self.has_direction,
            )  # fmt: skip
            for quantity, rows in estimates.items():
                rows.append(differentiate(subset, quantity, weights, axis, derivative_weights))
        wavelength = ("wavelength", self.dataset.wavelength.values, self.dataset.wavelength.attrs)
        return make_derivative_dataset(
            estimates, selected, wavelength, to_netcdf_attributes(dict(at))
        )

    def _select_stencil(
        self, at: dict[str, Any], variables: list[str] | None = None
    ) -> tuple[xr.Dataset, list[InterpolationWeights]]:
        """Return the nodes around a point and the interpolation weights of every axis."""
        at = check_axis_values(at, self.axes[:-1])
        subset, weights = self.dataset[variables or self._list_variables()], []
        for name in self.axes[:-1]:
            values = self.dataset[name].values
            if name not in at and values.size > 1:
                raise invalid(name, None, "given", "an axis of the table")
            axis_weights = compute_axis_weights(
                name, values, at.get(name, values[0]), has_direction=self.has_direction
            )
            # Only nodes with weights are read from a table on disk.
            needed = np.union1d(
                axis_weights.nodes, np.flatnonzero(axis_weights.error_weights.any(axis=0))
            )
            weights.append(axis_weights.restrict_to(needed))
            subset = subset.isel({name: needed})
        return load_selection(subset), weights

    @reject_unknown_arguments
    def to_csv(self, path: str | Path) -> None:
        """Write the table as CSV; see `splits.tables.export.write_csv`."""
        write_csv(self.dataset, path)

    @reject_unknown_arguments
    def to_spires(self, impurity: str, bands: Any, per_unit: float = 1000.0, **at: Any) -> Any:
        """Convert the table for spires; see `splits.tables.spires.convert_to_spires`."""
        return convert_to_spires(self.dataset, impurity, bands, per_unit, **at)

    @reject_unknown_arguments
    def to_isofit(self, **at: Any) -> xr.Dataset:
        """Convert the table for isofit; see `splits.tables.isofit.convert_to_isofit`."""
        return convert_to_isofit(self.dataset, **at)

    @reject_unknown_arguments
    def to_eradiate(
        self, wavelength: float | None = None, n_cosines: int = 51, n_azimuths: int = 72, **at: Any
    ) -> xr.Dataset:
        """Convert the table for eradiate; see `splits.tables.eradiate.convert_to_eradiate`."""
        return convert_to_eradiate(self.dataset, wavelength, n_cosines, n_azimuths, **at)

    @reject_unknown_arguments
    def to_bird(
        self,
        path: str | Path,
        provenance: Mapping[str, Any],
        license: Mapping[str, str] | None = None,
        **at: Any,
    ) -> None:
        """Write the table in the format of BiRDview; see `splits.tables.bird.write_bird`."""
        write_bird(self.dataset, path, provenance, license, **at)

    def _list_variables(self) -> list[str]:
        return [f"{q}{suffix}" for q in self.quantities for suffix in ("", "_stderr")]


@reject_unknown_arguments
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
    fits_in_memory = path.stat().st_size <= 1.2 * MAX_BYTES_IN_MEMORY
    return Table(load(path) if fits_in_memory else open_lazily(path))
