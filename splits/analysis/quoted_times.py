"""Times that docs quote from the benchmarks that are targets of the workflow."""

from __future__ import annotations

from collections.abc import Callable

import pandas as pd

from splits.analysis.efficiency import ADAPTIVE, LANES, THEORIES, UNIFORM, best_row
from splits.analysis.quoting import Number, Value, Where, cell, extreme
from splits.checks import refuse

SPEED, KERNELS = "benchmarks/speed_against_error.csv", "benchmarks/kernels.csv"


def _speed() -> dict[str, Number]:
    """Time against error of every way to a spectrum, one run of the benchmarks."""
    samples = {
        "representative": (0.004, 0.002, 0.001),
        "coarse wet": (0.004, 0.001),
        "thin layer": (0.004, 0.001),
        "smooth dry": (0.004, 0.001),
    }
    forms = {LANES: ".2f", "scalar": "#.2g", "one_by_one": ".0f"}
    papers = (UNIFORM, ADAPTIVE)
    found = {}
    for sample, errors in samples.items():
        for error in errors:
            key = f"speed.{sample.replace(' ', '_')}.{error:g}"
            for method in (*forms, *papers):
                found[f"{key}.{method}"] = Number(
                    SPEED, _seconds(sample, method, error), forms.get(method, ".0f")
                )
            for method in papers:
                found[f"{key}.{method}.ratio"] = Number(
                    SPEED, _seconds(sample, method, error, LANES), ".0f"
                )
    for theory in THEORIES:
        for name, largest in (("least", False), ("most", True)):
            for column, form in (("seconds", ".2g"), ("deviation_rms", ".3f")):
                found[f"speed.{theory}.{column}.{name}"] = Number(
                    SPEED, extreme(column, largest=largest, method=theory), form
                )
    for name, largest in (("least", False), ("most", True)):
        found[f"speed.z.{name}"] = Number(SPEED, extreme("deviation_z", largest=largest), ".1f")
    return found


def _seconds(
    sample: str, method: str, error: float, baseline_method: str = ""
) -> Callable[[pd.DataFrame], Value]:
    """Select the time of a method, or its ratio to that of a rival."""

    def select(table: pd.DataFrame) -> Value:
        one = best_row(table, sample, method, error)
        other = best_row(table, sample, baseline_method, error) if baseline_method else None
        if one is None or (baseline_method and other is None):
            raise refuse("rows", f"{sample}, {method}, {error:g}", "there")
        return one.seconds / (1.0 if other is None else other.seconds), None, ""

    return select


def _kernels() -> dict[str, Number]:
    """Lanes against the scalar kernel, what features cost, two cores against one."""
    media = {
        "snow, representative": (500, 1300), "snow, coarse wet": (500, 1300),
        "snow, thin layer": (500, 1300), "snow, smooth dry": (500, 1300),
        "sand, Fig 8 base": (500, 900), "sand, eight types, wet": (500, 900),
    }  # fmt: skip
    found: dict[str, Number] = {}
    for medium, wavelengths in media.items():
        for nm in wavelengths:
            one: Where = {
                "part": "lanes_against_scalar",
                "case": medium,
                "wavelength_nm": float(nm),
            }
            words = medium.lower().replace(",", "").split()
            key = f"kernels.{'_'.join(words)}.{nm}"
            found |= {
                f"{key}.events": Number(KERNELS, cell("events_per_ray", **one), ".0f"),
                f"{key}.scalar": Number(KERNELS, _per_event("compared_seconds", one), ".0f"),
                f"{key}.lanes": Number(KERNELS, _per_event("seconds", one), ".0f"),
                f"{key}.speedup": Number(KERNELS, cell("speedup", **one), ".1f"),
            }
    for error in ("0.001", "0.0005"):
        case = f"snow, representative, error {error}"
        found[f"kernels.cores.{error}"] = Number(
            KERNELS, cell("speedup", part="two_cores", case=case), ".2f"
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
        found[f"kernels.feature.{name}"] = Number(
            KERNELS, cell("relative_time", part="features", case=case), ".1f"
        )
    smooth = cell("seconds", scale=1e9, part="features", case="smooth")
    return found | {"kernels.feature.one": Number(KERNELS, smooth, ".0f")}


def _per_event(column: str, where: Where) -> Callable[[pd.DataFrame], Value]:
    """Select the time per event (ns) of the one row with these values."""

    def select(table: pd.DataFrame) -> Value:
        seconds, events = (cell(name, **where)(table)[0] for name in (column, "events_per_ray"))
        return 1e9 * seconds / events, None, ""

    return select


TIMES = {**_speed(), **_kernels()}
"""Numbers of `splits.analysis.quoted`."""
