"""What an experiment must be to read measured spectra in its table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from splits.core.validation import check_choice, invalid, key_prefix, snap_to_limits
from splits.experiments.config.retrieve import RetrieveSection, parse_incidence_deg
from splits.media.measured_inputs import OPTICAL_RADIUS_KEY, SURFACE_AREA_KEY
from splits.retrieval.forward_model import get_grid_ranges
from splits.retrieval.least_squares import check_enough_values
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import SCALE, StateVector
from splits.tables.axes import INCIDENCE

if TYPE_CHECKING:
    import pandas as pd

    from splits.experiments.config.experiment import ExperimentConfig

LAW_UNSUPPORTED_KEYWORDS = (
    "impurities_ng_g", "algae_cells_ml", "liquid_water_content", "saturation", "pores",
)  # fmt: skip
"""What a law that stands beside does not know, unless it is on the grid."""

AxisNodes = Mapping[str, tuple[Any, ...]]


def check_retrieve_section(experiment: ExperimentConfig) -> None:
    """Refuse retrievals from what is no table, or does not have what is to be found."""
    section, instrument, grid = experiment.retrieve, experiment.instrument, experiment.grid
    if section is None:
        return
    if instrument.kind != "table":
        raise invalid("instrument.kind", instrument.kind, "table with a section retrieve")
    if experiment.figure.model_fields_set:
        given = sorted(experiment.figure.model_fields_set)
        hint = "the figure is of what was retrieved"
        raise invalid("figure", given, "left out with a section retrieve", hint)
    if "reflectance" not in (instrument.quantities or ("reflectance",)):
        raise invalid("instrument.quantities", instrument.quantities, "with reflectance")
    rows = dict(zip(*experiment.make_axes(), strict=True))
    _check_models(section, rows)
    for key in ("free", "fixed", "prior", "reference_values"):
        allowed = grid if key == "fixed" else [*grid, SCALE]
        for name in getattr(section, key):
            check_choice(f"retrieve.{key}", name, allowed)
    with key_prefix("retrieve"):
        StateVector.from_ranges(
            section.free, section.prior or None, get_grid_ranges(experiment.make_axes())
        )
    for name in [n for n in section.fixed if n in section.free]:
        raise invalid(f"retrieve.fixed.{name}", section.fixed[name], "left out", "it is free")
    named = {*section.free, *section.fixed, section.model_axis, INCIDENCE}
    for name in [n for n, values in grid.items() if len(values) > 1]:
        if name not in named:
            raise invalid(f"retrieve.fixed.{name}", None, "given", "or make it free")
    for name in section.reference_values:
        check_choice("retrieve.reference_values", name, list(section.free))
    for name in section.fixed:
        if name in section.free:
            raise invalid(f"retrieve.fixed.{name}", section.fixed[name], "left out, as it is free")
    if not [name for name in section.free if name != SCALE]:
        raise invalid("retrieve.free", list(section.free), "at least one parameter of the grid")
    _check_reference_values(section, rows)
    _check_law(section, rows, experiment.medium)


def check_measured_spectra(experiment: ExperimentConfig, measured: pd.DataFrame) -> None:
    """Refuse measured spectra that the experiment's table could not be asked about.

    Raises
    ------
    ValueError
        For per cent, gaps, wavelengths or angles that the table does not have.
    """
    section = experiment.retrieve
    if section is None:
        return
    rows = dict(zip(*experiment.make_axes(), strict=True))
    first = {one.sample: one.fixed for one in section.prior_from}
    for name, spectrum in section.select_spectra(
        measured, experiment.instrument.get_wavelengths()
    ).items():
        with key_prefix(f"retrieve ({name})"):
            known = Measurement.from_input(spectrum, section.compute_noise(spectrum.to_numpy()))
            check_enough_values(
                len([n for n in section.free if n not in first.get(name, {})]), known
            )
        _check_sample_angle(name, experiment)
        where = section.get_fixed_values(name, list(rows))
        for axis, value in where.items():
            check_within_axis(f"retrieve ({name}): {axis}", value, rows.get(axis))
        given = {*where, *section.free, *first.get(name, {})}
        if len(rows.get(INCIDENCE, ())) > 1 and INCIDENCE not in given:
            hint = f"its angle in the name, {name}@50, or retrieve.fixed.{INCIDENCE}"
            raise invalid(f"retrieve ({name}): {INCIDENCE}", None, "given", hint)


def _check_sample_angle(sample: str, experiment: ExperimentConfig) -> None:
    """Refuse a sample whose name tells another angle of incidence than a table has alone."""
    angle, beam = parse_incidence_deg(sample), experiment.instrument.incidence_deg
    if angle is not None and INCIDENCE not in experiment.grid and angle != beam:
        allowed = f"of light from {beam}, which the table has alone"
        raise invalid("retrieve.samples", sample, allowed, f"or give grid.{INCIDENCE}")


def _check_models(section: RetrieveSection, axes: AxisNodes) -> None:
    """Refuse models that are no axis of texts, or that are given besides."""
    models = section.model_axis
    if models is None:
        return
    texts = [name for name, row in axes.items() if isinstance(row[0], str)]
    if models not in texts:
        allowed = f"one of {', '.join(texts)}" if texts else "left out: no axis is of texts"
        raise invalid("retrieve.model_axis", models, allowed, "an axis of the grid")
    given = [
        ("fixed", section.fixed),
        ("free", section.free),
        ("reference_values", section.reference_values),
    ]
    given += [("prior_from.fixed", first.fixed) for first in section.prior_from]
    for key, mapping in given:
        if models in mapping:
            raise invalid(f"retrieve.{key}.{models}", "given", "left out", "it is model_axis")


def _check_reference_values(section: RetrieveSection, axes: AxisNodes) -> None:
    """Refuse what is known outside the axes of the table."""
    for first in section.prior_from:
        for name, value in first.fixed.items():
            check_choice("retrieve.prior_from.fixed", name, [*axes, SCALE])
            check_within_axis(f"retrieve.prior_from.fixed.{name}", value, axes.get(name))
        if not [n for n in section.free if n not in (*first.fixed, SCALE)]:
            hint = "something of the first sample must be left to be found"
            raise invalid(
                "retrieve.prior_from.fixed", sorted(first.fixed), "not all that is free", hint
            )
    for name, values in section.reference_values.items():
        for sample, value in values.items():
            check_within_axis(f"retrieve.reference_values.{name}.{sample}", value, axes.get(name))


def check_within_axis(key: str, value: Any, nodes: tuple[Any, ...] | None) -> None:
    """Refuse a value that an axis does not reach."""
    if nodes is None:
        return
    if isinstance(nodes[0], str) or isinstance(value, str):
        check_choice(key, value, [str(one) for one in nodes])
    elif not nodes[0] <= snap_to_limits(value, nodes[0], nodes[-1]) <= nodes[-1]:
        raise invalid(key, value, f"{nodes[0]:g} to {nodes[-1]:g}, as far as the grid goes")


def _check_law(section: RetrieveSection, axes: AxisNodes, medium: Mapping[str, Any]) -> None:
    """Refuse a law beside a table of what it does not know."""
    key, law = "retrieve.compare_with", section.compare_with
    if law is None:
        return
    kind = medium.get("kind")
    if kind not in ("snow", "natural_snow"):
        raise invalid(key, law, "left out but for snow")
    if not {SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY} & set(axes):
        raise invalid(
            key, law, f"left out without {SURFACE_AREA_KEY} or {OPTICAL_RADIUS_KEY} on the grid"
        )
    held = [name for name in LAW_UNSUPPORTED_KEYWORDS if medium.get(name)]
    depth = medium.get("depth_m", math.inf if kind == "natural_snow" else None)
    if held or depth != math.inf:
        hint = "it is for deep, dry snow with what is on the grid"
        raise invalid(key, law, f"left out with {held[0] if held else 'a finite depth_m'}", hint)
    for name, row in axes.items():
        told = name in (section.model_axis, INCIDENCE, SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY)
        if not told and not name.startswith("impurities_ng_g.") and row[0] != 0.0:
            raise invalid(key, law, f"left out with {name} on the grid, unless that begins with 0")
