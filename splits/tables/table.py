"""Tables that were made: opened, looked up, and read between their nodes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import xarray as xr

from splits.core.arrays import as_1d_array, check_no_gaps
from splits.core.paths import expand_path
from splits.core.validation import check_choice, invalid, reject_unknown_arguments
from splits.io.integrity import NETCDF_LOCK
from splits.io.netcdf import load, open_lazily, to_netcdf_attributes
from splits.tables.axes import check_axis_values
from splits.tables.axis_order import check_complete, sort_axes
from splits.tables.derivatives import (
    DerivativeEstimate,
    check_derivative_axes,
    compute_derivative_weights,
    differentiate,
    make_derivative_dataset,
)
from splits.tables.export import convert_to_spires, write_csv
from splits.tables.interpolation import (
    InterpolationWeights,
    check_within_axis,
    compute_interpolation_weights,
)
from splits.tables.isofit import convert_to_isofit
from splits.tables.storage import MAX_BYTES_IN_MEMORY

Part = TypeVar("Part", xr.Dataset, xr.DataArray)


class Table:
    """A table of spectra.

    Parameters
    ----------
    dataset : xarray.Dataset
        As `splits.build_table` returns it, or a part of it, its axes in any order.

    Attributes
    ----------
    dataset : xarray.Dataset
        Axes of numbers ascend in it, and the wavelength is the last axis.

    Raises
    ------
    ValueError
        For another dataset, and where values, or what labels them, are missing.
    """

    @reject_unknown_arguments
    def __init__(self, dataset: xr.Dataset) -> None:
        self.dataset = sort_axes(dataset)
        if self.dataset.nbytes <= MAX_BYTES_IN_MEMORY:
            check_complete(self.dataset)

    def __repr__(self) -> str:
        """Return what the table holds, an axis to a line."""
        lines = [f"Table of {', '.join(self.quantities)}"]
        for name in self.axes:
            values = self.dataset[name].values
            span = f"{values[0]} to {values[-1]}" if values.dtype.kind == "f" else ", ".join(values)
            lines.append(f"  {name}: {values.size} from {span}")
        return "\n".join(lines)

    @property
    def quantities(self) -> list[str]:
        """What the table holds, besides errors."""
        return [str(n) for n in self.dataset.data_vars if f"{n}_stderr" in self.dataset.data_vars]

    @property
    def axes(self) -> list[str]:
        """Its axes, the wavelength last."""
        return [str(dim) for dim in self.dataset[self.quantities[0]].dims]

    @reject_unknown_arguments
    def interp(self, **at: Any) -> xr.Dataset:
        """Return values between nodes, with errors that hold what interpolation adds.

        Parameters
        ----------
        **at
            From axes to a number within it, or to one of its texts; ``wavelength`` may be a row
            of numbers.  Axes of one value may be left out, and so may the wavelength: then all of
            the table's are returned.  ``sza`` is short for ``incidence_deg``.

        Returns
        -------
        xarray.Dataset
            Each quantity over ``wavelength``, with ``…_stderr``: the error of the cells, as if
            all were off alike or each by itself, whichever is more, and of interpolation, in
            quadrature; ``…_interpolation_error`` is the second of these.

        Raises
        ------
        ValueError
            For an axis that there is not or that is missing, and outside the table.
        """
        at = check_axis_values(at, self.axes)
        wavelengths = self.dataset.wavelength.values
        wanted = wavelengths
        if "wavelength" in at:
            given = as_1d_array("wavelength", at.pop("wavelength"), "numbers in nanometres")
            wanted = np.array([check_within_axis("wavelength", wavelengths, one) for one in given])
        part, weights = self._select_stencil(at)
        parts = [_InterpolatedSpectra(part[q].values.astype(float), part[f"{q}_stderr"].values.astype(float))
                 for q in self.quantities]  # fmt: skip
        for found in weights:
            parts = [_interpolate_first_axis(read, found) for read in parts]
        if not np.array_equal(wanted, wavelengths):
            parts = [_interpolate_wavelengths(read, wavelengths, wanted) for read in parts]
        return self._make_dataset(parts, wanted, at)

    @reject_unknown_arguments
    def interpolation_errors(self, quantity: str, **at: Any) -> np.ndarray:
        """Return what interpolation along each axis misses, with its sign along the spectrum.

        One that is off is off in one way at all wavelengths, but whether up or down is not known.

        Parameters
        ----------
        quantity : str
        **at
            As for `interp`, without a wavelength.

        Returns
        -------
        float, shape (axes, wavelengths)
        """
        part, weights = self._select_stencil(at)
        values = part[quantity].values.astype(float)
        found: list[list[np.ndarray]] = []
        for w in weights:
            found = [[np.tensordot(w.weights, row[w.nodes], 1) for row in rows] for rows in found]
            found.append([np.tensordot(row, values, 1) for row in w.error_weights])
            values = np.tensordot(w.weights, values[w.nodes], 1)
        # Of the nodes that were left out, that which the others miss by most.
        none = np.zeros_like(values)
        largest = [max(rows, key=lambda r: float((r**2).sum()), default=none) for rows in found]
        return np.array(largest).reshape(-1, values.size)

    @reject_unknown_arguments
    def deviations(self, quantity: str, **at: Any) -> np.ndarray:
        """Return how far groups of rays take a value off, of a table that keeps its covariance.

        Parameters
        ----------
        quantity : str
        **at
            As for `interp`, without a wavelength.

        Returns
        -------
        float, shape (groups, wavelengths)
            Sums over groups of products are covariances.

        Raises
        ------
        ValueError
            For a table without them.
        """
        name = f"{quantity}_batches"
        if name not in self.dataset:
            raise invalid("table", quantity, "a table made with covariance=True")
        part, weights = self._select_stencil(at, [name])
        values = part[name].transpose(*self.axes[:-1], "batch", "wavelength").values.astype(float)
        for w in weights:
            values = np.tensordot(w.weights, values[w.nodes], 1)
        return values

    @reject_unknown_arguments
    def derivatives(self, names: Sequence[str], **at: Any) -> xr.Dataset:
        """Return derivatives to parameters along the axes, with errors that hold interpolation.

        Parameters
        ----------
        names : sequence of str
            Axes of numbers.
        **at
            As for `interp`, without a wavelength.

        Returns
        -------
        xarray.Dataset
            ``reflectance_jacobian`` and ``…_stderr`` over ``parameter`` and ``wavelength``, per
            unit of the parameter.  Errors of cells count as independent, which overstates those of
            cells that share paths, unless the table was made with ``covariance=True``.

        Raises
        ------
        ValueError
            As `interp`; and where light goes as a root from a value on.
        """
        axes = self.axes[:-1]
        at = check_axis_values(at, axes)
        numbers = [n for n in axes if self.dataset[n].dtype.kind == "f"]
        chosen = check_derivative_axes(names, numbers)
        groups = [f"{q}_batches" for q in self.quantities if f"{q}_batches" in self.dataset]
        part, weights = self._select_stencil(at, self._list_variables() + groups)
        found: dict[str, list[DerivativeEstimate]] = {q: [] for q in self.quantities}
        for name in chosen:
            which, nodes = axes.index(name), self.dataset[name].values
            here = np.searchsorted(nodes, part[name].values[weights[which].nodes])
            slope = compute_derivative_weights(
                name, nodes, here, check_within_axis(name, nodes, at.get(name, nodes[0]))
            )
            for quantity, rows in found.items():
                rows.append(differentiate(part, quantity, weights, which, slope))
        wavelength = ("wavelength", self.dataset.wavelength.values, self.dataset.wavelength.attrs)
        return make_derivative_dataset(found, chosen, wavelength, to_netcdf_attributes(dict(at)))

    def _select_stencil(
        self, at: dict[str, Any], variables: list[str] | None = None
    ) -> tuple[xr.Dataset, list[InterpolationWeights]]:
        """Return the part of the table around a place, and how values there are drawn from it."""
        at = check_axis_values(at, self.axes[:-1])
        part, weights = self.dataset[variables or self._list_variables()], []
        for name in self.axes[:-1]:
            values = self.dataset[name].values
            if name not in at and values.size > 1:
                raise invalid(name, None, "given", "an axis of the table")
            found = _compute_axis_weights(name, values, at.get(name, values[0]))
            # Only the nodes that count are read from a table that lies in its file.
            needed = np.union1d(found.nodes, np.flatnonzero(found.error_weights.any(axis=0)))
            weights.append(found.restrict_to(needed))
            part = part.isel({name: needed})
        return load_selection(part), weights

    @reject_unknown_arguments
    def to_csv(self, path: str | Path) -> None:
        """Write it as CSV, see `splits.tables.export.write_csv`."""
        write_csv(self.dataset, path)

    @reject_unknown_arguments
    def to_spires(self, impurity: str, bands: Any, per_unit: float = 1000.0, **at: Any) -> Any:
        """Return it as the package spires takes it, see `splits.tables.export.convert_to_spires`."""
        return convert_to_spires(self.dataset, impurity, bands, per_unit, **at)

    @reject_unknown_arguments
    def to_isofit(self, directions: xr.Dataset | None = None, **at: Any) -> xr.Dataset:
        """Return it as isofit looks it up, see `splits.tables.isofit.convert_to_isofit`."""
        return convert_to_isofit(self.dataset, directions, **at)

    def _list_variables(self) -> list[str]:
        return [f"{q}{end}" for q in self.quantities for end in ("", "_stderr")]

    def _make_dataset(
        self, spectra: list[_InterpolatedSpectra], wavelengths: np.ndarray, at: Any
    ) -> xr.Dataset:
        """Return what was read as a dataset."""
        variables: dict[str, Any] = {}
        for name, read in zip(self.quantities, spectra, strict=True):
            label = str(self.dataset[name].attrs.get("long_name", name))
            error = np.sqrt(read.stderr**2 + read.interpolation_error**2)
            for end, values, about in (
                ("", read.value, label),
                ("_stderr", error, f"standard error of {label}"),
                (
                    "_interpolation_error",
                    read.interpolation_error,
                    f"error of interpolation of {label}",
                ),
            ):
                facts = {"long_name": about, "units": "1"}
                variables[name + end] = ("wavelength", values, facts)
        axis = ("wavelength", wavelengths, self.dataset.wavelength.attrs)
        return xr.Dataset(variables, {"wavelength": axis}, to_netcdf_attributes(at))


def load_selection(selection: Part) -> Part:
    """Return a part of a table in memory, or refuse one with gaps."""
    # The library underneath bears one reader at a time.
    with NETCDF_LOCK:
        selection = selection.load()
    check_no_gaps("table", selection)
    return selection


class _InterpolatedSpectra:
    """Values, errors of the cells, and of interpolation, over the axes that are left."""

    def __init__(
        self, value: np.ndarray, stderr: np.ndarray, interpolation_error: np.ndarray | None = None
    ) -> None:
        self.value, self.stderr = value, stderr
        self.interpolation_error = (
            np.zeros_like(value) if interpolation_error is None else interpolation_error
        )


def _compute_axis_weights(name: str, nodes: np.ndarray, axis_value: Any) -> InterpolationWeights:
    """Return how a value is drawn from the nodes of an axis; of texts, from that one."""
    if nodes.dtype.kind == "f":
        return compute_interpolation_weights(name, nodes, axis_value)
    check_choice(name, str(axis_value), nodes.tolist())
    place = (nodes == str(axis_value)).argmax(keepdims=True)
    return InterpolationWeights(place, np.ones(1), place[:0], np.zeros((0, nodes.size)))


def _interpolate_first_axis(
    spectra: _InterpolatedSpectra, axis_weights: InterpolationWeights
) -> _InterpolatedSpectra:
    """Return what is read at a place of the first axis."""
    some = [
        spectra.value[axis_weights.nodes],
        spectra.stderr[axis_weights.nodes],
        spectra.interpolation_error[axis_weights.nodes],
    ]
    value = np.tensordot(axis_weights.weights, some[0], 1)
    # Cells share paths, or at least random numbers: how alike they are off is between the two.
    alike = np.abs(np.tensordot(axis_weights.weights, some[1], 1))
    stderr = np.maximum(alike, np.sqrt(np.tensordot(axis_weights.weights**2, some[1] ** 2, 1)))
    before = np.tensordot(np.abs(axis_weights.weights), some[2], 1)
    off = np.abs(np.tensordot(axis_weights.error_weights, spectra.value, 1))
    here = off.max(axis=0) if len(off) else np.zeros_like(value)
    return _InterpolatedSpectra(value, stderr, np.hypot(before, here))


def _interpolate_wavelengths(
    spectra: _InterpolatedSpectra, nodes: np.ndarray, wavelengths: np.ndarray
) -> _InterpolatedSpectra:
    """Return what is read at other wavelengths."""
    points = [
        _interpolate_first_axis(
            spectra, compute_interpolation_weights("wavelength", nodes, float(one))
        )
        for one in wavelengths
    ]
    value, stderr, missed = (
        np.array([getattr(one, name) for one in points])
        for name in ("value", "stderr", "interpolation_error")
    )
    return _InterpolatedSpectra(value, stderr, missed)


@reject_unknown_arguments
def open_table(path: str | Path) -> Table:
    """Open a table that was written; of a large one only what is asked for is read.

    Parameters
    ----------
    path : path
        Of a file that `splits.save` wrote, or the workflow.

    Raises
    ------
    ValueError
        For a file that holds no table, or is damaged.
    """
    hint = "splits.Table(…) takes a dataset" if isinstance(path, xr.Dataset) else ""
    path = expand_path(path, hint=hint)
    small = path.stat().st_size <= 1.2 * MAX_BYTES_IN_MEMORY
    return Table(load(path) if small else open_lazily(path))
