"""Plan of a table: ensembles of paths, each used for a group of points."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from splits.core.inputs import DIFFUSE
from splits.core.validation import invalid, suggest_name
from splits.discrete_ordinates.applicability import find_direction_obstacle
from splits.instruments.solver import DISCRETE_ORDINATES, choose_solver
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.simulation.shared_paths import (
    MAX_SHARED_ROWS,
    MediaGroup,
    PathSharingMedia,
    group_by_shared_paths,
)
from splits.tables.axes import ANGLES, INCIDENCE, ParameterGrid

MAX_VIEW_ROWS = 1000
"""Largest number of rows of one tally of directions, which needs up to 2 GB."""


class PathGroup(NamedTuple):
    """Points of a table that share an ensemble of paths.

    Attributes
    ----------
    incidence : float or "diffuse"
    incidences : tuple
        All incidences of the media in the table.
    path_sharing : PathSharingMedia
        Distinct media of the points.
    positions : int, shape (points,)
        Flat indices of the points in the table, or in the grid of its media where the table has
        other incidences.
    media_indices : int, shape (points,)
        Index of the medium of each point.
    """

    incidence: float | str
    incidences: tuple[float | str, ...]
    path_sharing: PathSharingMedia
    positions: np.ndarray
    media_indices: np.ndarray


class TablePlan(NamedTuple):
    """Plan of all ensembles of a table.

    Attributes
    ----------
    grid : ParameterGrid
    wavelengths : float, shape (wavelengths,)
        Wavelengths (nm).
    path_groups : tuple of PathGroup
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
        *,
        has_views: bool = False,
        with_diffuse: bool = False,
    ) -> TablePlan:
        """Return the plan of a table.

        Parameters
        ----------
        make_medium : callable
            Function of the parameters of a point, without the incidence, that returns a medium.
        grid : ParameterGrid
        wavelengths : float, shape (wavelengths,)
        incidence_deg : float or "diffuse"
            Incidence, unless it is an axis of the grid.
        has_views : bool
            Whether the table has directions of observation, which need more memory for each row.
        with_diffuse : bool
            Whether isotropic light is added.

        Raises
        ------
        ValueError
            For an invalid point; the message names it.
        """
        beams = grid.get_incidences(incidence_deg)
        media_axes = grid.drop(INCIDENCE)
        media = [make_point_medium(make_medium, point) for point in media_axes.iterate_points()]
        if with_diffuse and DIFFUSE in beams:
            raise invalid(INCIDENCE, DIFFUSE, "angles with quantities under isotropic light")
        max_rows = MAX_VIEW_ROWS if has_views else MAX_SHARED_ROWS
        media_groups = group_by_shared_paths(media, wavelengths, max_rows)
        incidences = (*beams, *([DIFFUSE] if with_diffuse else []))
        positions = np.arange(grid.size).reshape(grid.shape)
        if INCIDENCE in grid:
            positions = np.moveaxis(positions, list(grid).index(INCIDENCE), -1)
        positions = positions.reshape(len(media), len(beams))
        path_groups = tuple(
            PathGroup(beam, incidences, group.path_sharing, rows, group.media_indices)
            for group in media_groups
            for beam, rows in [
                *zip(beams, positions[group.positions].T, strict=True),
                *([(DIFFUSE, group.positions)] if with_diffuse else []),
            ]
        )
        sharing_axes = _find_path_sharing_axes(media_axes, media_groups)
        return cls(grid, wavelengths, path_groups, sharing_axes)

    def list_media(self) -> list[Medium]:
        """Return the distinct media of all points."""
        groups = {id(group.path_sharing): group.path_sharing for group in self.path_groups}
        return [medium for path_sharing in groups.values() for medium in path_sharing.media]

    def select_part(self, part: int, n_parts: int, solver: str) -> tuple[PathGroup, ...]:
        """Return the ensembles of one of several parts.

        Discrete ordinates solve all angles of incidence of a medium together, which are therefore
        in one part.
        """
        n_media_groups = len({id(one.path_sharing) for one in self.path_groups})
        n_beams = len(self.path_groups) // n_media_groups if solver == DISCRETE_ORDINATES else 1
        numbered = enumerate(self.path_groups)
        return tuple(one for number, one in numbered if number // n_beams % n_parts == part)

    def __str__(self) -> str:
        """Return a one-line summary of the plan."""
        n_groups, shared = len(self.path_groups), self.path_sharing_axes
        axes = f" ({', '.join(shared)})" if shared else ""
        return (
            f"{len(shared)} of {len(self.grid)} axes share paths{axes}: "
            f"{n_groups} ensemble{'s' if n_groups > 1 else ''} "
            f"for {self.grid.size} spectra of {self.wavelengths.size} wavelengths"
        )


def choose_table_solver(
    solver: Any, media: Iterable[Medium], wavelengths: np.ndarray, covariance: bool,
    max_stderr: float = np.inf, has_views: bool = False,
) -> str:  # fmt: skip
    """Return the solver for all media of a table, see `splits.instruments.solver.choose_solver`."""
    return choose_solver(
        solver, media, wavelengths, max_stderr=max_stderr,
        obstacle="a covariance needs batches of rays" if covariance else None,
        find_further_obstacle=lambda one: find_direction_obstacle(one) if has_views else None,
    ).solver  # fmt: skip


def make_point_medium(
    make_medium: Callable[..., Any], point: dict[str, Any],
    check: Callable[[Any], None] = lambda medium: None,
) -> Medium:  # fmt: skip
    """Return the medium of a point of the grid, after a further check; errors name the point."""
    try:
        medium: Medium = make_medium(**point)
        check_medium(medium, allow_semi_infinite=True)
        check(medium)
    except (ValueError, TypeError) as error:
        for name in point if isinstance(error, TypeError) else ():
            # The medium does not take an axis whose name is a synonym of an angle.
            hint = suggest_name(name, ANGLES)
            if hint and name in str(error) and "did you mean" not in str(error):
                allowed = "a parameter of the medium, or an angle"
                raise invalid(f"grid.{name}", point[name], allowed, hint) from None
        point_text = ", ".join(f"{name} = {value!r}" for name, value in point.items())
        raise invalid("grid", point_text, "a medium", str(error)) from None
    return medium


def _find_path_sharing_axes(grid: ParameterGrid, media_groups: list[MediaGroup]) -> tuple[str, ...]:
    """Return the axes along which all points share paths."""
    group_number = np.empty(grid.size, dtype=int)
    for number, group in enumerate(media_groups):
        group_number[group.positions] = number
    group_number = group_number.reshape(grid.shape)
    return tuple(
        name
        for number, (name, row) in enumerate(grid.items())
        if len(row) > 1 and (group_number == np.take(group_number, [0], axis=number)).all()
    )
