"""What a model says a measurement would be: from a table, or from runs of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
import xarray as xr

from splits.checks import one_of, refuse
from splits.lookup.axes import Axes, check_places
from splits.lookup.formats import band_weights
from splits.lookup.interpolation import spaced, weights_at
from splits.lookup.reading import Table, load_part
from splits.retrieval.coordinates import LEVEL, Free, Widest
from splits.retrieval.cubics import read, read_all
from splits.retrieval.descents import Grid
from splits.retrieval.measurement import Measurement

ALIKE_NM = 400.0
"""Over which errors of cells are taken to be alike."""
LEVELS = (0.2, 5.0)
"""Widest range of the factor of a measurement."""


class Model(Protocol):
    """What a retrieval asks of a model, at places given by coordinates."""

    free: Free

    def values(self, places: np.ndarray) -> np.ndarray:
        """Return what would be measured, shape (places, n)."""
        ...

    def with_slopes(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what would be measured, shape (n,), and slopes, shape (n, parameters)."""
        ...

    def covariance(self, place: np.ndarray) -> np.ndarray:
        """Return the covariance of what the model itself is off by, shape (n, n)."""
        ...


class Operator(NamedTuple):
    """How a measurement comes from the wavelengths of a table.

    Attributes
    ----------
    matrix : float, shape (n, wavelengths)
    missed : float, shape (n, wavelengths)
        What reading between wavelengths misses.
    """

    matrix: np.ndarray
    missed: np.ndarray

    @classmethod
    def of(cls, measurement: Measurement, wavelengths: np.ndarray) -> Operator:
        """Return it, or refuse wavelengths outside of the table."""
        if measurement.bands:
            rows = [band_weights(n, band, wavelengths) for n, band in measurement.bands.items()]
            return cls(np.stack(rows), np.zeros((len(rows), wavelengths.size)))
        matrix, missed = np.zeros((2, measurement.values.size, wavelengths.size))
        for row, off, one in zip(matrix, missed, measurement.wavelength_nm, strict=True):
            w = weights_at("wavelength", wavelengths, float(one))
            row[w.nodes] = w.share
            if len(w.others):
                off[:] = max(w.others, key=lambda r: float((r**2).sum()))
        return cls(matrix, missed)


class OfTable:
    """A measurement as a table has it.

    Parameters
    ----------
    table : Table
    measurement : Measurement
    free : Free
        Axes of the table, and perhaps the measurement's level.
    at : mapping, optional
        Values of the other axes; those of one node may be left out.
    quantity : str
    """

    def __init__(
        self,
        table: Table,
        measurement: Measurement,
        free: Free,
        at: Mapping[str, Any] | None,
        quantity: str = "reflectance",
    ) -> None:
        self.free, self.table, self.quantity = free, table, quantity
        self.at = _fixed(table, free, at)
        self.measurement = measurement
        self.operator = Operator.of(measurement, table.dataset.wavelength.values)
        self.axes = [name for name in free.names if name != LEVEL]
        if not self.axes:
            raise refuse("free", list(free.names), "at least one axis of the table")
        self._level = free.names.index(LEVEL) if LEVEL in free.names else None
        self._rows = [free.names.index(name) for name in self.axes]
        values, nodes = _slice(table, quantity, self.axes, self.at)
        self.cells = np.ascontiguousarray(
            values.reshape(-1, values.shape[-1]) @ self.operator.matrix.T
        )
        most = max(len(row) for row in nodes)
        of_axes = [free.coordinates_of(i, row) for i, row in zip(self._rows, nodes, strict=True)]
        self._nodes = np.array([np.pad(row, (0, most - len(row))) for row in of_axes])
        self._counts = np.array([len(row) for row in nodes], dtype=np.int64)

    def grid(self, cells: np.ndarray) -> Grid:
        """Return the table over coordinates, with other columns."""
        return Grid(np.ascontiguousarray(cells), self._nodes, self._counts)

    def _scale(self, places: np.ndarray) -> np.ndarray:
        if self._level is None:
            return np.ones(places.shape[:-1])
        scale: np.ndarray = self.free.at(places)[..., self._level]
        return scale

    def values(self, places: np.ndarray) -> np.ndarray:
        """Return what would be measured, shape (places, n)."""
        found = np.empty((len(places), self.cells.shape[1]))
        at = np.ascontiguousarray(places[:, self._rows])
        read_all(self.cells, self._nodes, self._counts, at, found)
        return found * self._scale(places)[:, np.newaxis]

    def with_slopes(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what would be measured, shape (n,), and slopes, shape (n, parameters)."""
        count = self.cells.shape[1]
        values, along = np.empty(count), np.empty((count, len(self.axes)))
        at = np.ascontiguousarray(place[self._rows])
        read(self.cells, self._nodes, self._counts, at, values, along)
        scale = float(self._scale(place))
        slopes = np.zeros((count, len(self.free.names)))
        slopes[:, self._rows] = scale * along
        if self._level is not None:
            slopes[:, self._level] = values * (self.free.high - self.free.low)[self._level]
        return scale * values, slopes

    def covariance(self, place: np.ndarray) -> np.ndarray:
        """Return the covariance of what the table is off by, shape (n, n).

        Errors of cells are alike at wavelengths that share rays: as the table says, where it keeps
        that, else over `ALIKE_NM`.  What interpolation along an axis misses has a spectrum of its
        own, which may look like that of a parameter, so it is taken for one error at all
        wavelengths.
        """
        natural = self.free.at(place)
        where = {name: float(natural[self.free.names.index(name)]) for name in self.axes}
        given = {name: value for name, value in self.at.items() if name in self.table.axes}
        there, q = self.table.interp(**given, **where), self.quantity
        missed = there[f"{q}_interpolation_error"].values
        cells = np.sqrt(np.maximum(there[f"{q}_stderr"].values ** 2 - missed**2, 0.0))
        own = np.abs(self.operator.matrix) @ cells
        along = self.table.interpolation_errors(q, **given, **where) @ self.operator.matrix.T
        between = self.operator.missed @ there[q].values
        found = self._of_cells(own, {**given, **where}) + along.T @ along + np.diag(between**2)
        return float(self._scale(place)) ** 2 * found

    def _of_cells(self, own: np.ndarray, at: dict[str, Any]) -> np.ndarray:
        """Return the covariance of the errors of cells, whose standard errors are known."""
        if f"{self.quantity}_groups" not in self.table.dataset:
            w = self.measurement.wavelength_nm
            alike = np.exp(-np.abs(w[:, np.newaxis] - w) / ALIKE_NM)
            return alike * own[:, np.newaxis] * own
        groups = self.table.deviations(self.quantity, **at) @ self.operator.matrix.T
        found: np.ndarray = groups.T @ groups
        # The standard errors hold what stands for interpolation between refractive indices, too.
        return found + np.diag(np.maximum(own**2 - np.diag(found), 0.0))

    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the coordinates of all cells in the ranges, and what would be measured there."""
        grids = np.meshgrid(*(self.table.dataset[name].values for name in self.axes), indexing="ij")
        natural = np.zeros((grids[0].size, len(self.free.names)))
        for i, grid in zip(self._rows, grids, strict=True):
            natural[:, i] = grid.ravel()
        if self._level is not None:
            natural[:, self._level] = np.clip(
                1.0, self.free.low[self._level], self.free.high[self._level]
            )
        inside = ((natural >= self.free.low) & (natural <= self.free.high)).all(axis=1)
        if not inside.any():
            places = np.full((1, len(self.free.names)), 0.5)
            return places, self.values(places)
        scale = natural[inside, self._level] if self._level is not None else 1.0
        return self.free.coordinates(natural[inside]), (self.cells[inside].T * scale).T


def ranges_of(table: Table) -> dict[str, Widest]:
    """Return the ranges of all axes of a table that may be free, and that of a level."""
    names = table.axes[:-1]
    rows = tuple(tuple(table.dataset[name].values.tolist()) for name in names)
    return ranges_of_axes(Axes(tuple(names), rows))


def ranges_of_axes(axes: Axes) -> dict[str, Widest]:
    """Return what `ranges_of` returns of a table over these axes."""
    found = {}
    for name, row in zip(*axes, strict=True):
        if len(row) > 1 and not isinstance(row[0], str):
            kind, _ = spaced(name, np.array(row, dtype=float))
            found[name] = Widest(float(row[0]), float(row[-1]), kind)
    return found | {LEVEL: Widest(*LEVELS, "itself")}


def _fixed(table: Table, free: Free, at: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the values of the axes that are not free, or refuse them."""
    found = check_places(at, table.axes[:-1], "at.", free=free.names)
    for name in table.axes[:-1]:
        if name not in free.names and name not in found and table.dataset[name].size > 1:
            raise refuse(f"at.{name}", None, "given", "an axis of the table that is not free")
    return found


def _slice(
    table: Table, quantity: str, axes: list[str], at: Mapping[str, Any]
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return values over some axes and wavelength, others held, and how nodes are spaced."""
    part, shares = table.dataset[quantity], {}
    for name in table.axes[:-1]:
        if name in axes:
            continue
        nodes = table.dataset[name].values
        given = at.get(name, nodes[0])
        if nodes.dtype.kind != "f":
            part = part.sel({name: one_of(f"at.{name}", str(given), nodes.tolist())})
            continue
        w = weights_at(name, nodes, given)
        part, shares[name] = part.isel({name: w.nodes}), w.share
    part = load_part(part)
    for name, share in shares.items():
        part = part.dot(xr.DataArray(share, dims=name), name)
    values = part.transpose(*axes, "wavelength").values.astype(float)
    return values, [table.dataset[name].values for name in axes]
