"""Validation of the section `retrieve_return` against the table of its experiment."""

from __future__ import annotations

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.validation import InvalidValue, invalid, key_prefix, unknown_key
from splits.experiments.config.beam_instruments import ReturnTable, dump_pulse
from splits.experiments.config.measured_return import MeasuredReturn, RetrieveReturnSection
from splits.experiments.config.retrieve_checks import check_on_grid, check_parameters
from splits.experiments.config.simulation import SimulationConfig
from splits.instruments.delay_record import Pulse, check_granular_layers, check_record
from splits.media.medium import Medium
from splits.retrieval.retrieve_return import check_return_noise, make_return_operator, read_return
from splits.retrieval.state_vector import SCALE
from splits.tables.axes import INCIDENCE

SECTION = "retrieve_return"


def check_return_section(experiment: SimulationConfig, section: RetrieveReturnSection) -> None:
    """Reject a retrieval that the table of returns of its experiment does not allow."""
    instrument = experiment.instrument
    if not isinstance(instrument, ReturnTable):
        allowed = f"return_table with a section {SECTION}"
        raise invalid("instrument.kind", instrument.kind, allowed)
    rows = dict(zip(*experiment.make_axes(), strict=True))
    with key_prefix(SECTION):
        check_parameters(section, rows, [])
        for name, value in section.fixed.items():
            check_on_grid(f"fixed.{name}", value, rows.get(name))
        for name, values in section.list_references().items() if section.measured else ():
            for sample, value in values.items():
                check_on_grid(f"reference_values.{name}.{sample}", value, rows.get(name))
        if section.synthetic:
            _check_truth(experiment, section)


def _check_truth(experiment: SimulationConfig, section: RetrieveReturnSection) -> None:
    """Reject known media that the table does not contain, or bins outside its record."""
    assert section.synthetic is not None
    if not section.synthetic.truth:
        raise invalid("synthetic.truth", {}, "at least one sample")
    rows = dict(zip(*experiment.make_axes(), strict=True))
    for sample, values in section.synthetic.truth.items():
        key = f"synthetic.truth.{sample}"
        for name in [n for n in section.free if n != SCALE]:
            if name not in values:
                raise invalid(f"{key}.{name}", None, "given", "it is free")
            check_on_grid(f"{key}.{name}", values[name], rows[name])
        if not values.get(SCALE, 1.0) > 0.0:
            raise invalid(f"{key}.{SCALE}", values[SCALE], "above 0")
        with key_prefix(key):
            medium, _ = make_true_medium(experiment, section, sample)
            check_granular_layers(medium)
    pulse = Pulse.from_argument(dump_pulse(section.pulse))
    try:
        edges, _ = check_record(section.synthetic.delay_s, None, pulse)
        shape = experiment.instrument.get_wavelengths().size, edges.size - 1
        _check_return(experiment, section, section.scale_counts(np.ones(shape), edges))
    except InvalidValue as error:
        key = "pulse" if error.key == "pulse" else "synthetic.delay_s"
        raise invalid(key, error.value, error.allowed, error.hint) from None


def make_true_medium(
    experiment: SimulationConfig, section: RetrieveReturnSection, sample: str
) -> tuple[Medium, float | str]:
    """Return a known medium and the incidence angle of its light."""
    assert section.synthetic is not None
    rows = dict(zip(*experiment.make_axes(), strict=True))
    single = {name: row[0] for name, row in rows.items() if len(row) == 1}
    values = {**single, **section.fixed, **section.synthetic.truth[sample]}
    incidence = values.pop(INCIDENCE, experiment.instrument.get_incidence())
    values.pop(SCALE, None)
    keywords = experiment.list_medium_keywords()
    for name in values:
        if name not in rows and name.partition(".")[0] not in keywords:
            raise unknown_key(name, dict.fromkeys([*rows, *keywords, SCALE]))
    return experiment.make_medium(**values), incidence


def check_measured_returns(
    experiment: SimulationConfig, section: RetrieveReturnSection, measured: pd.DataFrame
) -> None:
    """Reject gaps, and delays outside the record of the experiment's table."""
    returns = section.select_returns(measured, experiment.instrument.get_wavelengths())
    for name, one in returns.items():
        with key_prefix(f"{SECTION} ({name})"):
            _check_return(experiment, section, one)


def _check_return(
    experiment: SimulationConfig, section: RetrieveReturnSection, measured: MeasuredReturn
) -> None:
    """Reject a return that a table with the record of the experiment cannot predict."""
    assert isinstance(experiment.instrument, ReturnTable)
    wavelengths, record = experiment.instrument.get_wavelengths(), experiment.instrument.get_edges()
    edges, _ = read_return((measured.edges, measured.rates), wavelengths)
    check_return_noise(measured.noise, edges, wavelengths)
    bounds = ("delay", "bounds"), np.column_stack([record[:-1], record[1:]])
    table = xr.Dataset(coords={"wavelength": wavelengths, "delay_bounds": bounds})
    make_return_operator(table, edges, Pulse.from_argument(dump_pulse(section.pulse)))
