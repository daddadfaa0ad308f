"""What is to be traced for a table: ensembles of paths, each for all points that it serves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from splits.core.validation import invalid
from splits.simulation.arguments import check_incidence, check_medium
from splits.simulation.path_reuse import MediaGroup, group_by_shared_paths
from splits.simulation.path_tally import PathSharingMedia
from splits.tables.axes import INCIDENCE, ParameterGrid


class PathGroup(NamedTuple):
    """Points of a table that share paths.

    Attributes
    ----------
    number : int
        Its place among all of the table's.
    incidence : float or "diffuse"
    path_sharing : PathSharingMedia
        The different media among the points'.
    positions : int, shape (points,)
        Of the points in the table, counted as its axes run.
    media_indices : int, shape (points,)
        Medium of each point.
    """

    number: int
    incidence: float | str
    path_sharing: PathSharingMedia
    positions: np.ndarray
    media_indices: np.ndarray


class TablePlan(NamedTuple):
    """All ensembles of a table.

    Attributes
    ----------
    grid : ParameterGrid
    wavelengths : float, shape (wavelengths,)
        nm.
    path_groups : tuple of Ensemble
    path_sharing_axes : tuple of str
        Axes along which all points share paths.
    """

    grid: ParameterGrid
    wavelengths: np.ndarray
    path_groups: tuple[PathGroup, ...]
    path_sharing_axes: tuple[str, ...]

    @classmethod
    def from_grid(
        cls,
        make_medium: Callable[..., Any],
        grid: ParameterGrid,
        wavelengths: np.ndarray,
        incidence_deg: float | str = 0.0,
    ) -> TablePlan:
        """Return the plan of a table, or refuse a point of it.

        Parameters
        ----------
        make_medium : callable
            Takes the parameters of a point but the incidence, returns a medium.
        grid : ParameterGrid
        wavelengths : float, shape (wavelengths,)
        incidence_deg : float or "diffuse"
            Where that is no axis.

        Raises
        ------
        ValueError
            Names the point that cannot be.
        """
        if INCIDENCE in grid.names and incidence_deg != 0.0:
            allowed = f"left out beside grid.{INCIDENCE}, the same"
            raise invalid(INCIDENCE, incidence_deg, allowed)
        media_axes = grid.drop(INCIDENCE)
        media = [_make_medium(make_medium, point) for point in media_axes.iterate_points()]
        beams = [check_incidence(one) for one in grid.get_values(INCIDENCE, incidence_deg)]
        found = group_by_shared_paths(media, wavelengths)
        places = np.arange(grid.size).reshape(grid.shape)
        if INCIDENCE in grid.names:
            places = np.moveaxis(places, grid.names.index(INCIDENCE), -1)
        places = places.reshape(len(media), len(beams))
        ensembles = [
            PathGroup(0, beam, one.path_sharing, places[one.positions, row], one.media_indices)
            for one in found
            for row, beam in enumerate(beams)
        ]
        numbered = tuple(e._replace(number=number) for number, e in enumerate(ensembles))
        return cls(grid, wavelengths, numbered, _find_path_sharing_axes(media_axes, found))

    def __str__(self) -> str:
        """Return what is shared by what, in a line."""
        names, count = self.grid.names, self.grid.size
        ensembles = (
            "1 ensemble" if len(self.path_groups) == 1 else f"{len(self.path_groups)} ensembles"
        )
        those = f" ({', '.join(self.path_sharing_axes)})" if self.path_sharing_axes else ""
        return (
            f"{len(self.path_sharing_axes)} of {len(names)} axes share paths{those}: {ensembles} for "
            f"{count} spectra of {self.wavelengths.size} wavelengths"
        )


def _make_medium(make_medium: Callable[..., Any], point: dict[str, Any]) -> Any:
    """Return the medium of a point of the grid, or say which one cannot be."""
    try:
        medium = make_medium(**point)
        check_medium(medium, allow_semi_infinite=True)
    except (ValueError, TypeError) as error:
        where = ", ".join(f"{name} = {value!r}" for name, value in point.items())
        raise invalid("grid", where, "a medium", str(error)) from None
    return medium


def _find_path_sharing_axes(grid: ParameterGrid, media_groups: list[MediaGroup]) -> tuple[str, ...]:
    """Return the axes along which nothing but absorption, ground and size changes."""
    family = np.empty(grid.size, dtype=int)
    for number, one in enumerate(media_groups):
        family[one.positions] = number
    family = family.reshape(grid.shape)
    several = [(number, name) for number, name in enumerate(grid.names) if grid.shape[number] > 1]
    return tuple(
        name for number, name in several if (family == np.take(family, [0], axis=number)).all()
    )
