"""What a user leaves free of a medium that is retrieved by runs, and what is refused of that."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from splits.arrays import numbers
from splits.checks import in_range, refuse, under, unknown_key
from splits.instruments.arguments import check_incidence, check_medium
from splits.instruments.progress import Report
from splits.lookup.axes import check_places
from splits.lookup.interpolation import spaced
from splits.media.measured_inputs import check_one_of_each
from splits.media.parameters import INCIDENCE, value_of, with_value
from splits.media.turbid import Medium
from splits.retrieval.coordinates import LEVEL, Free, Widest
from splits.retrieval.forward import LEVELS
from splits.retrieval.measurement import Measurement
from splits.retrieval.runs import OfRuns


def free_of(medium: Any, ranges: Any, prior: Any, incidence: float | str) -> Free:
    """Return what a user leaves free of a medium, or refuse it.

    Parameters
    ----------
    medium : Medium
    ranges : mapping
        (low, high) by name: numbers of the medium as for derivatives, ``incidence_deg``, ``level``.
    prior : mapping or None
    incidence : float or "diffuse"

    Raises
    ------
    ValueError
        For a parameter that the medium does not have, or ends of a range that no medium has.
    """
    check_medium(medium, allow_semi_infinite=True)
    if not isinstance(ranges, Mapping):
        hint = 'such as {"optical_radius_um": (50, 1500)}: without a table nothing else tells'
        raise refuse("free", ranges, "(low, high) by name", hint)
    with under("free"):
        check_one_of_each({str(name): pair for name, pair in ranges.items()})
    known: dict[str, Widest] = {LEVEL: Widest(*LEVELS, "itself")}
    for name, pair in ranges.items():
        if name == LEVEL:
            continue
        if name != INCIDENCE:
            value_of(medium, name)
        elif incidence == "diffuse":
            raise unknown_key(f"free.{name}", ["level"])
        ends = np.array(numbers(f"free.{name}", pair, ("low", "high")))
        if not ends[0] < ends[1]:
            raise refuse(f"free.{name}", pair, "low < high")
        for value in ends if name != INCIDENCE else ():
            try:
                with_value(medium, name, float(value))
            except ValueError as error:
                raise refuse(f"free.{name}", float(value), "what a medium can have",
                             str(error)) from None  # fmt: skip
        for value in ends if name == INCIDENCE else ():
            check_incidence(float(value))
        middle = np.array([ends[0], 0.5 * ends.sum(), ends[1]])
        known[name] = Widest(float(ends[0]), float(ends[1]), spaced(name, middle)[0])
    return Free.from_ranges(dict(ranges), prior, known)


def incidence_of(at: Mapping[str, Any] | None, ranges: Any) -> float | str:
    """Return the incidence that a measurement of a medium was made under, or refuse it."""
    free = ranges if isinstance(ranges, Mapping) else ()
    return check_incidence(check_places(at, [INCIDENCE], "at.", free_axes=free).get(INCIDENCE, 0.0))


def runs_of(
    medium: Medium,
    measurement: Measurement,
    state_vector: Free,
    incidence: float | str,
    max_stderr: float | None,
    seed: int,
    progress: Report = None,
) -> OfRuns:
    """Return a measurement as runs have it, or refuse an error of theirs."""
    if max_stderr is not None:
        max_stderr = in_range("max_stderr", max_stderr, 1e-6, 0.5)
    return OfRuns(medium, measurement, state_vector, incidence, max_stderr, seed, progress)
