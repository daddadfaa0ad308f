"""Validation of the section `retrieve` against the table of its experiment."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from splits.core.validation import check_choice, invalid, key_prefix, snap_to_limits
from splits.experiments.config.instrument_kinds import TableInstrument
from splits.experiments.config.measured_return import RetrieveReturnSection
from splits.experiments.config.retrieve import RetrieveSection, parse_incidence_deg
from splits.experiments.config.simulation import SimulationConfig
from splits.media.natural_snow import OPTICAL_RADIUS_KEY, SURFACE_AREA_KEY
from splits.retrieval.forward_model import get_grid_ranges
from splits.retrieval.least_squares import check_enough_values
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import SCALE, StateVector
from splits.tables.axes import INCIDENCE, ParameterGrid

if TYPE_CHECKING:
    import pandas as pd

LAW_UNSUPPORTED_KEYWORDS = (
    "impurities_ng_g", "algae_cells_ml", "liquid_water_content", "saturation", "pores",
)  # fmt: skip
"""Keywords of snow that a published law does not describe, unless they are on the grid."""

AxisNodes = Mapping[str, tuple[Any, ...]]


def check_retrieve_section(experiment: SimulationConfig, section: RetrieveSection) -> None:
    """Reject a retrieval that the table of its experiment does not allow."""
    instrument = experiment.instrument
    if not isinstance(instrument, TableInstrument):
        raise invalid("instrument.kind", instrument.kind, "table with a section retrieve")
    quantities = instrument.quantities or ()
    if section.quantity not in quantities:
        raise invalid("instrument.quantities", quantities, f"with {section.quantity}")
    views = instrument.get_views()
    if views and "quantity" not in section.model_fields_set:
        allowed = "given: reflectance or reflectance_factor"
        raise invalid("retrieve.quantity", None, allowed, "the table has directions")
    rows = dict(zip(*experiment.make_axes(), strict=True))
    _check_models(section, rows)
    with key_prefix("retrieve"):
        check_parameters(section, rows, views)
    _check_reference_values(section, rows)
    _check_law(section, rows, experiment.medium)


def check_parameters(
    section: RetrieveSection | RetrieveReturnSection, axes: AxisNodes, views: Iterable[str]
) -> None:
    """Reject unknown parameters, and axes of the grid without a value.

    `views` are axes of directions, which are not on the grid.
    """
    views = [*views]
    grid = [name for name in axes if name not in views]
    known = {
        "free": [*grid, SCALE],
        "fixed": [*grid, *views],
        "prior": [*grid, SCALE],
        "reference_values": section.free,
    }
    for key, names in known.items():
        for name in getattr(section, key):
            check_choice(key, name, names)
    nodes = ParameterGrid(tuple(axes), tuple(axes.values()))
    ranges = get_grid_ranges(nodes, has_direction=bool(views))
    StateVector.from_ranges(section.free, section.prior or None, ranges)
    for name in [n for n in section.fixed if n in section.free]:
        raise invalid(f"fixed.{name}", section.fixed[name], "left out", "it is free")
    assigned = {*section.free, *section.fixed}
    if isinstance(section, RetrieveSection):
        # The names of spectra may contain their angles.
        assigned |= {section.model_axis or "", INCIDENCE}
    for name in [n for n, values in axes.items() if len(values) > 1]:
        if name not in assigned:
            raise invalid(f"fixed.{name}", None, "given", "or make it free")
    if not [name for name in section.free if name != SCALE]:
        raise invalid("free", list(section.free), "at least one parameter of the grid")


def check_measured_spectra(
    experiment: SimulationConfig, section: RetrieveSection, measured: pd.DataFrame
) -> None:
    """Reject values in per cent, gaps, and wavelengths or angles outside the experiment's table."""
    rows = dict(zip(*experiment.make_axes(), strict=True))
    fixed_of_first = {source.sample: source.fixed for source in section.prior_from}
    spectra = section.select_spectra(measured, experiment.instrument.get_wavelengths())
    for name, spectrum in spectra.items():
        noise, known = section.compute_noise(spectrum.to_numpy()), fixed_of_first.get(name, {})
        with key_prefix(f"retrieve ({name})"):
            measurement = Measurement.from_input(spectrum, noise)
            check_enough_values(len([n for n in section.free if n not in known]), measurement)
        _check_sample_angle(name, experiment)
        fixed = section.get_fixed_values(name, list(rows))
        for axis, value in fixed.items():
            check_on_grid(f"retrieve ({name}): {axis}", value, rows.get(axis))
        assigned = {*fixed, *section.free, *known}
        if len(rows.get(INCIDENCE, ())) > 1 and INCIDENCE not in assigned:
            hint = f"its angle in the name, {name}@50, or retrieve.fixed.{INCIDENCE}"
            raise invalid(f"retrieve ({name}): {INCIDENCE}", None, "given", hint)


def _check_sample_angle(sample: str, experiment: SimulationConfig) -> None:
    """Reject a sample with an angle of incidence other than the single one of the table."""
    angle, beam = parse_incidence_deg(sample), experiment.instrument.get_incidence()
    if angle is not None and INCIDENCE not in experiment.grid and angle != beam:
        allowed = f"of incidence {beam}, the only one of the table"
        raise invalid("retrieve.samples", sample, allowed, f"or give grid.{INCIDENCE}")


def _check_models(section: RetrieveSection, axes: AxisNodes) -> None:
    """Reject a model axis that is no axis of texts, or that other settings name as well."""
    axis = section.model_axis
    if axis is None:
        return
    text_axes = [name for name, row in axes.items() if isinstance(row[0], str)]
    if axis not in text_axes:
        allowed = f"one of {', '.join(text_axes)}" if text_axes else "left out: no axis is of texts"
        raise invalid("retrieve.model_axis", axis, allowed, "an axis of the grid")
    owners: dict[str, Iterable[str]] = {
        key: getattr(section, key) for key in ("fixed", "free", "reference_values")
    }
    owners["prior_from.fixed"] = [name for first in section.prior_from for name in first.fixed]
    for key, names in owners.items():
        if axis in names:
            raise invalid(f"retrieve.{key}.{axis}", "given", "left out", "it is model_axis")


def _check_reference_values(section: RetrieveSection, axes: AxisNodes) -> None:
    """Reject reference values and priors outside the axes of the table."""
    for first in section.prior_from:
        for name, value in first.fixed.items():
            check_choice("retrieve.prior_from.fixed", name, [*axes, SCALE])
            check_on_grid(f"retrieve.prior_from.fixed.{name}", value, axes.get(name))
        if not [n for n in section.free if n not in (*first.fixed, SCALE)]:
            key, hint = "retrieve.prior_from.fixed", "the first sample needs a free parameter"
            raise invalid(key, sorted(first.fixed), "not all of retrieve.free", hint)
    for name, values in section.reference_values.items():
        for sample, value in values.items():
            check_on_grid(f"retrieve.reference_values.{name}.{sample}", value, axes.get(name))


def check_on_grid(key: str, value: Any, nodes: tuple[Any, ...] | None) -> None:
    """Reject a value outside the range of an axis."""
    if nodes is None:
        return
    if isinstance(nodes[0], str) or isinstance(value, str):
        check_choice(key, value, [str(node) for node in nodes])
    elif not nodes[0] <= snap_to_limits(value, nodes[0], nodes[-1]) <= nodes[-1]:
        raise invalid(key, value, f"{nodes[0]:g} to {nodes[-1]:g}, the range of the grid")


def _check_law(section: RetrieveSection, axes: AxisNodes, medium: Mapping[str, Any]) -> None:
    """Reject a law that does not describe the media of the table."""
    key, law = "retrieve.compare_with", section.compare_with
    if law is None:
        return
    kind = medium.get("kind")
    if kind not in ("snow", "natural_snow"):
        raise invalid(key, law, "left out for media other than snow")
    if not {SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY} & set(axes):
        allowed = f"left out without {SURFACE_AREA_KEY} or {OPTICAL_RADIUS_KEY} on the grid"
        raise invalid(key, law, allowed)
    unsupported = [name for name in LAW_UNSUPPORTED_KEYWORDS if medium.get(name)]
    if medium.get("depth_m", math.inf if kind == "natural_snow" else None) != math.inf:
        unsupported.append("a finite depth_m")
    if unsupported:
        hint = "it describes deep, dry snow with the parameters of the grid"
        raise invalid(key, law, f"left out with {unsupported[0]}", hint)
    for name, row in axes.items():
        is_described = name in (section.model_axis, INCIDENCE, SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY)
        if not is_described and not name.startswith("impurities_ng_g.") and row[0] != 0.0:
            raise invalid(key, law, f"left out with {name} on the grid, unless it starts at 0")
