"""Retrieval from a medium: validation of its free parameters, and choice of the model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from splits.core.arrays import check_named_numbers
from splits.core.progress import ProgressCallback
from splits.core.validation import (
    InvalidValue,
    check_choice,
    check_range,
    invalid,
    key_prefix,
    unknown_key,
)
from splits.discrete_ordinates.applicability import find_obstacle, find_parameter_obstacle
from splits.instruments.solver import MONTE_CARLO, SOLVERS, choose_solver
from splits.media.kinds import check_medium
from splits.media.medium import Medium
from splits.media.parameters import INCIDENCE_KEY, get_parameter, replace_parameter
from splits.media.snow import check_no_equivalents
from splits.retrieval.forward_model import SCALE_RANGE
from splits.retrieval.measurement import Measurement
from splits.retrieval.medium_model import MediumForwardModel
from splits.retrieval.ordinates_model import MAX_ERROR, OrdinatesForwardModel
from splits.retrieval.simulation_model import SimulationForwardModel
from splits.retrieval.state_vector import SCALE, ParameterRange, StateVector
from splits.simulation.run_options import check_incidence
from splits.tables.axes import check_axis_values
from splits.tables.interpolation import transform_axis


def make_medium_state_vector(
    medium: Any, ranges: Any, prior: Any, incidence: float | str
) -> StateVector:
    """Return the state vector of a medium's free parameters.

    Parameters
    ----------
    medium : Medium
    ranges : mapping
        (low, high) by name, for parameters of derivatives, ``incidence_deg`` and ``scale``.
    prior : mapping or None
    incidence : float or "diffuse"

    Raises
    ------
    ValueError
        For an unknown parameter, or a range outside the limits of the medium.
    """
    check_medium(medium, allow_semi_infinite=True)
    if not isinstance(ranges, Mapping):
        hint = 'such as {"optical_radius_um": (50, 1500)}; only a table has default ranges'
        raise invalid("free", ranges, "a mapping of names to (low, high)", hint)
    with key_prefix("free"):
        check_no_equivalents({str(name): pair for name, pair in ranges.items()})
    allowed_ranges: dict[str, ParameterRange] = {SCALE: ParameterRange(*SCALE_RANGE, "identity")}
    for name, pair in ranges.items():
        if name == SCALE:
            continue
        if name != INCIDENCE_KEY:
            get_parameter(medium, name, [INCIDENCE_KEY, SCALE])
        elif incidence == "diffuse":
            raise unknown_key(f"free.{name}", ["scale"])
        limits = np.array(check_named_numbers(f"free.{name}", pair, ("low", "high")))
        if not limits[0] < limits[1]:
            raise invalid(f"free.{name}", pair, "low < high")
        for value in limits if name != INCIDENCE_KEY else ():
            try:
                replace_parameter(medium, name, float(value))
            except InvalidValue as error:
                is_own = error.key == name.rpartition(".")[2]
                allowed = error.allowed if is_own else "a valid value of the medium"
                hint = error.hint if is_own else str(error)
                raise invalid(f"free.{name}", float(value), allowed, hint) from None
        for value in limits if name == INCIDENCE_KEY else ():
            check_incidence(float(value))
        middle = np.array([limits[0], 0.5 * limits.sum(), limits[1]])
        allowed_ranges[name] = ParameterRange(
            float(limits[0]), float(limits[1]), transform_axis(name, middle)[0]
        )
    return StateVector.from_ranges(dict(ranges), prior, allowed_ranges)


def check_measurement_incidence(fixed: Mapping[str, Any] | None, ranges: Any) -> float | str:
    """Return the incidence of a measurement of a medium; reject an invalid one."""
    free = ranges if isinstance(ranges, Mapping) else ()
    return check_incidence(
        check_axis_values(fixed, [INCIDENCE_KEY], "fixed.", free_axes=free).get(INCIDENCE_KEY, 0.0)
    )


def make_medium_model(
    medium: Medium, measurement: Measurement, state_vector: StateVector,
    incidence: float | str, solver: str, max_stderr: float | None, seed: int,
    progress: ProgressCallback,
) -> MediumForwardModel:  # fmt: skip
    """Return the forward model by discrete ordinates or by simulation; see `choose_solver`."""
    if max_stderr is not None:
        max_stderr = check_range("max_stderr", max_stderr, 1e-6, 0.5)
    arguments = medium, measurement, state_vector, incidence, seed
    if check_choice("solver", solver, SOLVERS) != MONTE_CARLO:
        model = OrdinatesForwardModel(*arguments)
        media, obstacle = model.list_extreme_media(), None
        if find_obstacle(medium, model.wavelengths) is None:
            obstacle = find_parameter_obstacle(media[0], model.names)
        if choose_solver(solver, media, model.wavelengths, obstacle) != MONTE_CARLO:
            model.choose_streams(max_stderr or MAX_ERROR)
            return model
    return SimulationForwardModel(*arguments, max_stderr, progress)
