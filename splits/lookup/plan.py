"""What is to be traced for a table: ensembles of paths, each for all points that it serves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from splits.checks import refuse
from splits.instruments.arguments import check_incidence, check_medium
from splits.instruments.families import Members, families
from splits.instruments.shared_paths import Family
from splits.lookup.axes import INCIDENCE, Axes


class Ensemble(NamedTuple):
    """Points of a table that share paths.

    Attributes
    ----------
    number : int
        Its place among all of the table's.
    incidence : float or "diffuse"
    family : Family
        The different media among the points'.
    places : int, shape (points,)
        Of the points in the table, counted as its axes run.
    which : int, shape (points,)
        Medium of each point.
    """

    number: int
    incidence: float | str
    family: Family
    places: np.ndarray
    which: np.ndarray


class Plan(NamedTuple):
    """All ensembles of a table.

    Attributes
    ----------
    axes : Axes
    wavelengths : float, shape (wavelengths,)
        nm.
    ensembles : tuple of Ensemble
    shared : tuple of str
        Axes along which all points share paths.
    """

    axes: Axes
    wavelengths: np.ndarray
    ensembles: tuple[Ensemble, ...]
    shared: tuple[str, ...]

    @classmethod
    def of(
        cls,
        make: Callable[..., Any],
        axes: Axes,
        wavelengths: np.ndarray,
        incidence_deg: float | str = 0.0,
    ) -> Plan:
        """Return the plan of a table, or refuse a point of it.

        Parameters
        ----------
        make : callable
            Takes the parameters of a point but the incidence, returns a medium.
        axes : Axes
        wavelengths : float, shape (wavelengths,)
        incidence_deg : float or "diffuse"
            Where that is no axis.

        Raises
        ------
        ValueError
            Names the point that cannot be.
        """
        if INCIDENCE in axes.names and incidence_deg != 0.0:
            allowed = f"left out beside grid.{INCIDENCE}, the same"
            raise refuse(INCIDENCE, incidence_deg, allowed)
        media_axes = axes.without(INCIDENCE)
        media = [_made(make, point) for point in media_axes.points()]
        beams = [check_incidence(one) for one in axes.row(INCIDENCE, incidence_deg)]
        found = families(media, wavelengths)
        places = np.arange(axes.size).reshape(axes.shape)
        if INCIDENCE in axes.names:
            places = np.moveaxis(places, axes.names.index(INCIDENCE), -1)
        places = places.reshape(len(media), len(beams))
        ensembles = [
            Ensemble(0, beam, one.family, places[one.places, row], one.which)
            for one in found
            for row, beam in enumerate(beams)
        ]
        numbered = tuple(e._replace(number=number) for number, e in enumerate(ensembles))
        return cls(axes, wavelengths, numbered, _shared(media_axes, found))

    def __str__(self) -> str:
        """Return what is shared by what, in a line."""
        names, count = self.axes.names, self.axes.size
        ensembles = "1 ensemble" if len(self.ensembles) == 1 else f"{len(self.ensembles)} ensembles"
        those = f" ({', '.join(self.shared)})" if self.shared else ""
        return (
            f"{len(self.shared)} of {len(names)} axes share paths{those}: {ensembles} for "
            f"{count} spectra of {self.wavelengths.size} wavelengths"
        )


def _made(make: Callable[..., Any], point: dict[str, Any]) -> Any:
    """Return the medium of a point of the grid, or say which one cannot be."""
    try:
        medium = make(**point)
        check_medium(medium, endless=True)
    except (ValueError, TypeError) as error:
        where = ", ".join(f"{name} = {value!r}" for name, value in point.items())
        raise refuse("grid", where, "a medium", str(error)) from None
    return medium


def _shared(axes: Axes, found: list[Members]) -> tuple[str, ...]:
    """Return the axes along which nothing but absorption, ground and size changes."""
    family = np.empty(axes.size, dtype=int)
    for number, one in enumerate(found):
        family[one.places] = number
    family = family.reshape(axes.shape)
    several = [(number, name) for number, name in enumerate(axes.names) if axes.shape[number] > 1]
    return tuple(
        name for number, name in several if (family == np.take(family, [0], axis=number)).all()
    )
