"""Time against error: scaling, figures of merit, deviations, figure and cached reference."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import splits
from benchmarks import performance
from benchmarks.performance import (
    MEASURED,
    MEASURED_PARTLY,
    METHODS,
    PAPER_ADAPTIVE,
    PAPER_UNIFORM,
    SCALED,
    VECTORIZED,
    draw_speed_against_error,
    make_time_table,
)

PROGRAM = Path(__file__).parents[2] / "benchmarks" / "speed_against_error.py"


def make_row(method, how, error, seconds, **changes):
    row = {"medium": "snow", "deviation_largest": 0.01, "stderr_largest": error} | changes
    return {"method": method, "how": how, "error": error, "seconds": seconds} | row


@pytest.fixture
def table():
    rows = [
        make_row(VECTORIZED, MEASURED, 0.002, 1.0),
        make_row(VECTORIZED, MEASURED, 0.001, 4.0),
        make_row(PAPER_UNIFORM, MEASURED_PARTLY, 0.002, 50.0),
        make_row(PAPER_UNIFORM, SCALED, 0.001, 200.0),
        make_row(PAPER_ADAPTIVE, MEASURED_PARTLY, 0.002, 10.0),
        make_row(PAPER_ADAPTIVE, SCALED, 0.001, 40.0),
        make_row(PAPER_ADAPTIVE, MEASURED_PARTLY, 0.001, 44.0),
        make_row("kz04", MEASURED, np.nan, 0.01, stderr_largest=np.nan),
    ]
    return pd.DataFrame(rows)


def make_spectrum(shift=0.0, stderr=0.001, wavelength=(500.0, 1000.0, 1500.0)):
    reflectance = np.array([0.9, 0.6, 0.1])[: len(wavelength)] + shift
    transmittance = np.full(len(wavelength), 0.05)
    values = (reflectance, transmittance, 1.0 - reflectance - transmittance)
    variables = {}
    for name, value in zip(performance.QUANTITIES, values, strict=True):
        variables[name] = ("wavelength", value)
        variables[f"{name}_stderr"] = ("wavelength", np.full(len(wavelength), stderr))
    return xr.Dataset(variables, {"wavelength": list(wavelength)})


def test_time_scales_with_the_inverse_squared_error():
    seconds, rays = np.array([1.0, 0.1]), np.array([1000.0, 4000.0])
    stderr = np.array([0.004, 0.002])
    # At 0.002 the first needs 4000 rays at 1 ms, the second 4000 at 25 µs.
    uniform_s, uniform_rays, adaptive_s, adaptive_rays = performance.scale_paper_times(
        seconds, rays, stderr, 0.002, 1
    )
    assert (uniform_rays, adaptive_rays) == (8000.0, 8000.0)
    assert uniform_s == pytest.approx(4.1)
    assert adaptive_s == pytest.approx(4.1)
    uniform_s, _, adaptive_s, _ = performance.scale_paper_times(
        seconds, rays, np.array([0.004, 0.001]), 0.002, 1
    )
    assert uniform_s == pytest.approx(4.1)
    assert adaptive_s == pytest.approx(4.025)


def test_rays_are_at_least_those_of_the_first_round():
    ones = np.ones(2)
    _, uniform_rays, _, adaptive_rays = performance.scale_paper_times(ones, ones, ones, 10.0, 100)
    assert uniform_rays == adaptive_rays == 200.0


def test_figures_of_merit_compare_times_at_equal_error(table):
    merits = performance.add_figures_of_merit(table).set_index(["method", "how", "error"])
    assert merits.loc[(VECTORIZED, MEASURED, 0.002), "over_uniform"] == pytest.approx(50.0)
    # Measured times are preferred to scaled times.
    assert merits.loc[(VECTORIZED, MEASURED, 0.001), "over_adaptive"] == pytest.approx(11.0)
    assert merits.loc[(PAPER_UNIFORM, MEASURED_PARTLY, 0.002), "over_uniform"] == 1.0
    # The reached error is used, here half of the requested one.
    table.loc[0, "stderr_largest"] = 0.001
    better = performance.add_figures_of_merit(table)
    assert better.over_uniform[0] == pytest.approx(200.0)


def test_theories_have_no_figure_of_merit(table):
    theory = performance.add_figures_of_merit(table).iloc[-1]
    assert theory[["figure_of_merit", "over_uniform", "over_adaptive"]].isna().all()


def test_headline_states_times_and_ratios(table):
    assert performance.format_headline(table, "snow", 0.001, 211) == (
        "snow, 211 wavelengths, error 0.001: vectorized kernel 4 s, papers' algorithm uniform "
        "200 s (50), adaptive 44 s (11)"
    )
    with pytest.raises(ValueError, match=VECTORIZED):
        performance.format_headline(table[table.method != VECTORIZED], "snow", 0.001, 211)


def test_deviations_from_a_reference():
    deviations = performance.compute_deviations(make_spectrum(0.002), make_spectrum())
    assert deviations["deviation_rms"] == pytest.approx(0.002)
    assert deviations["deviation_largest"] == pytest.approx(0.002)
    # Reflectance and absorptance deviate by 0.002, transmittance does not.
    assert deviations["deviation_z"] == pytest.approx(
        0.002 / np.hypot(0.001, 0.001) * np.sqrt(2.0 / 3.0)
    )
    subset = performance.compute_deviations(
        make_spectrum(0.002, wavelength=(500.0, 1000.0)), make_spectrum()
    )
    assert subset["deviation_largest"] == pytest.approx(0.002)


def test_deviations_of_a_theory_have_no_standard_error():
    theory = make_spectrum(0.01).drop_vars([f"{name}_stderr" for name in performance.QUANTITIES])
    deviations = performance.compute_deviations(theory, make_spectrum())
    assert deviations["deviation_largest"] == pytest.approx(0.01)
    assert np.isnan(deviations["deviation_z"])


def test_stated_errors_are_summarized():
    dataset = make_spectrum(stderr=0.001)
    dataset.reflectance_stderr[0] = 0.003
    stated = performance.summarize_stated_errors(dataset)
    assert stated["stderr_largest"] == pytest.approx(0.003)
    assert stated["stderr_rms"] == pytest.approx(0.001 * np.sqrt(11.0 / 3.0))


def test_repeated_runs_are_combined():
    runs = [
        {"deviation_largest": 0.03, "deviation_rms": 3.0},
        {"deviation_largest": 0.01, "deviation_rms": 4.0},
    ]
    assert performance.combine_runs(runs) == {
        "deviation_largest": 0.03,
        "deviation_rms": pytest.approx(12.5**0.5),
    }
    assert performance.combine_runs([]) == {}


def test_times_are_those_at_the_smallest_error_of_all_three(table):
    row = make_time_table(table).iloc[0]
    assert row.tolist() == ["snow", 0.001, 4.0, 200.0, 44.0, 50.0, 11.0]
    assert make_time_table(table[table.method != VECTORIZED]).empty


def test_figure_has_a_panel_per_medium(table):
    rows = pd.concat([table, table.assign(medium="sand")])
    figure = draw_speed_against_error(rows)
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["(a) snow", "(b) sand"]
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts[-1] == "scaled"
    assert METHODS[VECTORIZED] in texts and METHODS["one_by_one"] not in texts
    open_markers = [
        line
        for line in figure.axes[0].lines
        if line.get_marker() not in ("None", None) and line.get_markerfacecolor() == "white"
    ]
    assert sum(len(line.get_xdata()) for line in open_markers) == 2
    line = next(line for line in figure.axes[0].lines if line.get_linestyle() == "-")
    assert figure.axes[0].get_xscale() == figure.axes[0].get_yscale() == "log"
    assert len(line.get_xdata()) <= 2


@pytest.fixture
def program(monkeypatch):
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(variable, "1")
    monkeypatch.syspath_prepend(str(PROGRAM.parent))
    spec = importlib.util.spec_from_file_location("speed_against_error", PROGRAM)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "speed_against_error", module)
    spec.loader.exec_module(module)
    return module


def test_reference_is_cached_until_its_sources_change(program, monkeypatch, tmp_path):
    plan = replace(program.QUICK, step_nm=700, reference_stderr=0.1)
    calls = []

    def simulate(medium, wavelengths, error, **keywords):
        calls.append(keywords)
        dataset = make_spectrum(wavelength=wavelengths[:3])
        return dataset.assign_attrs(splits_version="0", stop_reason="converged")

    monkeypatch.setattr(program, "simulate_spectrum", simulate)
    snow = splits.Snow()
    first = program.load_or_compute_reference("a b", snow, plan, tmp_path)
    reloaded = program.load_or_compute_reference("a b", snow, plan, tmp_path)
    assert len(calls) == 1
    xr.testing.assert_equal(first, reloaded)
    program.load_or_compute_reference("a b", replace(snow, depth_m=0.05), plan, tmp_path)
    assert len(calls) == 2
    monkeypatch.setattr(program, "compute_source_digest", lambda medium: "other")
    program.load_or_compute_reference("a b", snow, plan, tmp_path)
    assert len(calls) == 3
    assert calls[0]["seed"] != program.SEED
