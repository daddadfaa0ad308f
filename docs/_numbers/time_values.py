"""Times in documents, from the benchmarks of the workflow."""

from __future__ import annotations

from collections.abc import Callable

import pandas as pd

from _numbers.formatting import QuotedNumber, QuotedValue, RowFilter, select_cell, select_extreme
from benchmarks.performance import (
    PAPER_ADAPTIVE,
    PAPER_UNIFORM,
    THEORIES,
    VECTORIZED,
    find_best_row,
)
from splits.core.validation import invalid

SPEED_FILE, KERNELS_FILE = "benchmarks/speed_against_error.csv", "benchmarks/kernels.csv"
SOLVERS_FILE = "benchmarks/solvers.csv"


def _list_speed_numbers() -> dict[str, QuotedNumber]:
    """Return the numbers of time against error for all methods."""
    samples = {
        "representative": (0.004, 0.002, 0.001),
        "coarse wet": (0.004, 0.001),
        "thin layer": (0.004, 0.001),
        "smooth dry": (0.004, 0.001),
    }
    formats = {VECTORIZED: ".2f", "scalar": "#.2g", "one_by_one": ".0f"}
    papers = (PAPER_UNIFORM, PAPER_ADAPTIVE)
    numbers = {}
    for sample, errors in samples.items():
        for error in errors:
            key = f"speed.{sample.replace(' ', '_')}.{error:g}"
            for method in (*formats, *papers):
                numbers[f"{key}.{method}"] = QuotedNumber(
                    SPEED_FILE, _select_seconds(sample, method, error), formats.get(method, ".0f")
                )
            for method in papers:
                numbers[f"{key}.{method}.ratio"] = QuotedNumber(
                    SPEED_FILE, _select_seconds(sample, method, error, VECTORIZED), ".0f"
                )
    for theory in THEORIES:
        for name, largest in (("least", False), ("most", True)):
            for column, number_format in (("seconds", ".2g"), ("deviation_rms", ".3f")):
                numbers[f"speed.{theory}.{column}.{name}"] = QuotedNumber(
                    SPEED_FILE,
                    select_extreme(column, largest=largest, method=theory),
                    number_format,
                )
    for name, largest in (("least", False), ("most", True)):
        numbers[f"speed.z.{name}"] = QuotedNumber(
            SPEED_FILE, select_extreme("deviation_z", largest=largest), ".1f"
        )
    return numbers


def _select_seconds(
    sample: str, method: str, error: float, baseline_method: str = ""
) -> Callable[[pd.DataFrame], QuotedValue]:
    """Return a selector of the time of a method, or of its ratio to that of another."""

    def select(table: pd.DataFrame) -> QuotedValue:
        row = find_best_row(table, sample, method, error)
        baseline = find_best_row(table, sample, baseline_method, error) if baseline_method else None
        if row is None or (baseline_method and baseline is None):
            raise invalid("rows", f"{sample}, {method}, {error:g}", "in the table")
        return row.seconds / (1.0 if baseline is None else baseline.seconds), None, ""

    return select


def _list_kernel_numbers() -> dict[str, QuotedNumber]:
    """Return the numbers of lanes against the scalar kernel, features, and two cores."""
    media = {
        "snow, representative": (500, 1300), "snow, coarse wet": (500, 1300),
        "snow, thin layer": (500, 1300), "snow, smooth dry": (500, 1300),
        "sand, Fig 8 base": (500, 900), "sand, eight types, wet": (500, 900),
    }  # fmt: skip
    numbers: dict[str, QuotedNumber] = {}
    for medium, wavelengths in media.items():
        for nm in wavelengths:
            filters: RowFilter = {
                "part": "vectorized_against_scalar",
                "case": medium,
                "wavelength_nm": float(nm),
            }
            words = medium.lower().replace(",", "").split()
            key = f"kernels.{'_'.join(words)}.{nm}"
            numbers |= {
                f"{key}.events": QuotedNumber(
                    KERNELS_FILE, select_cell("events_per_ray", **filters), ".0f"
                ),
                f"{key}.scalar": QuotedNumber(
                    KERNELS_FILE, _select_time_per_event("compared_seconds", filters), ".0f"
                ),
                f"{key}.vectorized": QuotedNumber(
                    KERNELS_FILE, _select_time_per_event("seconds", filters), ".0f"
                ),
                f"{key}.speedup": QuotedNumber(
                    KERNELS_FILE, select_cell("speedup", **filters), ".1f"
                ),
            }
    for error in ("0.001", "0.0005"):
        case = f"snow, representative, error {error}"
        numbers[f"kernels.cores.{error}"] = QuotedNumber(
            KERNELS_FILE, select_cell("speedup", part="two_cores", case=case), ".2f"
        )
    unused = (
        "water", "extinction in reflection", "mixed types, coatings",
    )  # fmt: skip
    cases = {"facets": "facets"} | {
        f"{grains}.{feature.split()[0]}": f"{grains}, {feature} unused"
        for grains in ("smooth", "facets")
        for feature in unused
    }
    cases |= {
        "used.water": "facets, S = 0.3",
        "used.mixed": "sand, mixed particles only",
        "used.base": "sand, Fig 8 base",
    }
    for name, case in cases.items():
        numbers[f"kernels.feature.{name}"] = QuotedNumber(
            KERNELS_FILE, select_cell("relative_time", part="features", case=case), ".1f"
        )
    smooth = select_cell("seconds", scale=1e9, part="features", case="smooth")
    return numbers | {"kernels.feature.one": QuotedNumber(KERNELS_FILE, smooth, ".0f")}


def _select_time_per_event(column: str, where: RowFilter) -> Callable[[pd.DataFrame], QuotedValue]:
    """Return a selector of the time per event (ns) in the only matching row."""

    def select(table: pd.DataFrame) -> QuotedValue:
        seconds, events = (
            select_cell(name, **where)(table)[0] for name in (column, "events_per_ray")
        )
        return 1e9 * seconds / events, None, ""

    return select


def _list_solver_numbers() -> dict[str, QuotedNumber]:
    """Return the numbers of time against error for all ways to a spectrum of natural snow."""
    ways = {
        "ordinates": ("error 0.002", "error 0.0001", "error 1e-05"),
        "paths": ("error 0.004", "error 0.002", "error 0.001"),
        "PythonicDISORT": ("8 streams", "16 streams"),
        "table": ("12 sizes",), "TARTES": ("two streams",), "snowoptics": ("asymptotic",),
    }  # fmt: skip
    slow = ("paths", "PythonicDISORT")
    numbers: dict[str, QuotedNumber] = {}
    for snowpack in ("half-space", "three layers on soil"):
        for way, settings in ways.items():
            if snowpack != "half-space" and way in ("table", "snowoptics"):
                continue
            for number, setting in enumerate(settings):
                columns = {
                    "ms": ("milliseconds", ".0f" if way in slow else "#.2g"),
                    "deviation": ("deviation_largest", "#.2g"),
                }
                for name, (column, spec) in columns.items():
                    key = f"solvers.{snowpack.split('-')[0].split()[0]}.{way.lower()}.{number}"
                    select = select_cell(column, snowpack=snowpack, way=way, setting=setting)
                    numbers[f"{key}.{name}"] = QuotedNumber(SOLVERS_FILE, select, spec)
    return numbers


TIMING_NUMBERS = {**_list_speed_numbers(), **_list_kernel_numbers(), **_list_solver_numbers()}
"""Numbers of `_numbers.values`."""
