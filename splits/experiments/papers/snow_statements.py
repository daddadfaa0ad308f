"""Statements of the SPLITSnow paper, simulated for any interpretation.

Stages are ordered from cheap to costly.  Each is a set of statements (numbers of tables and
figures, qualitative trends) and the runs that give our values.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.analysis.sensitivity import compute_spectral_sensitivity
from splits.experiments.papers.angular_statements import (
    compute_grain_trends,
    compute_incidence_trends,
    compute_nadir_trends,
)
from splits.experiments.papers.estimate import Estimate
from splits.experiments.papers.interpretation_runs import (
    WATER_TABLES,
    InterpretationRun,
    StatementValues,
    repeat_for_waters,
)
from splits.experiments.papers.misfit import TREND_TOLERANCE, PublishedStatement

TABLE3_WAVELENGTHS_NM = {"table3_842": 842.25, "table3_1074": 1073.76, "table3_1238": 1237.93}
PARAMETER_EXTREMES: dict[str, tuple[Any, ...]] = {
    "grain_size": ((100, 200), (900, 1000)),
    "facetness": ((0, 0.2, 0.1, 0.072), (0.8, 1, 0.9, 0.072)),
    "saturation": (0.0, 0.1, 0.3, 1.0),
    "density": (100.0, 200.0, 400.0, 450.0),
}
"""Extremes of parameters for sensitivities (section 5.4).  The paper does not state those of
saturation and density, so any two of these values are considered."""

SNOW_KEYWORDS = {
    "grain_size": "grain_size_um", "facetness": "facetness", "saturation": "saturation",
    "density": "density_kg_m3",
}  # fmt: skip
SENSITIVITY_SPECTRA = {
    "r": ("reflectance", 0.12, np.arange(400.0, 2501.0, 50.0)),
    "t": ("transmittance", 0.02, np.arange(400.0, 1421.0, 30.0)),
}
"""Quantity, depth (m) and wavelengths (nm) of the sensitivities."""


TRANSMITTANCE_FLOORS = (0.0, 0.005, 0.02)
"""Transmittances below which values may have counted as 0 in a sensitivity.  The paper states no
threshold, and the ratio of two small values is large."""


def _compute_grain_distance(run: InterpretationRun) -> StatementValues:
    return {
        "grain_distance": repeat_for_waters(
            run.make_snow(density_kg_m3=450.0).mean_grain_distance_m, 0.0
        )
    }


def _compute_table3(run: InterpretationRun) -> StatementValues:
    spectra = run.simulate_spectra(
        list(TABLE3_WAVELENGTHS_NM.values()), run.errors.bands, 62.3, depth_m=0.25
    )
    value, error = (
        np.array([spectrum[name].values for spectrum in spectra]).T
        for name in ("reflectance", "reflectance_stderr")
    )
    return dict(zip(TABLE3_WAVELENGTHS_NM, zip(value, error, strict=True), strict=True))


def _compute_max_transmittance(run: InterpretationRun) -> StatementValues:
    """Return the largest transmittance, at the wavelengths where snow absorbs least (Fig 7)."""
    spectra = run.simulate_spectra(np.arange(400.0, 501.0, 20.0), run.errors.transmittance)
    best = [
        Estimate.from_dataset(s, "transmittance")
        .isel(wavelength=int(s.transmittance.argmax("wavelength")))
        .to_floats()
        for s in spectra
    ]
    value, error = np.transpose(best)
    return {"transmittance_max": (value, error)}


def _make_sensitivity_stage(
    parameters: Sequence[str], letters: Sequence[str]
) -> Callable[[InterpretationRun], StatementValues]:
    """Return the stage that computes sensitivity indices, shape (waters, pairs, floors)."""

    def compute(run: InterpretationRun) -> StatementValues:
        values: StatementValues = {}
        for parameter, letter in itertools.product(parameters, letters):
            quantity, depth, wavelengths = SENSITIVITY_SPECTRA[letter]
            error = getattr(run.errors, f"{quantity}s")
            spectra = []
            for number, extreme in enumerate(PARAMETER_EXTREMES[parameter], start=1):
                settings = {SNOW_KEYWORDS[parameter]: extreme, "depth_m": depth}
                run_spectra = run.simulate_spectra(wavelengths, error, 0.0, number, **settings)
                spectra.append(run_spectra)
            floors = TRANSMITTANCE_FLOORS[: None if quantity == "transmittance" else 1]
            indices = _compute_sensitivity_indices(spectra, quantity, floors)
            values[f"msi_{letter}_{parameter}"] = indices
        return values

    return compute


def list_extreme_pairs(parameter: str) -> list[str]:
    """Return the labels of the pairs of extremes of a parameter, in the order of the indices."""

    def format_extreme(value: Any) -> str:
        limits = np.atleast_1d(value)[:2]
        return "-".join(f"{limit:g}" for limit in limits)

    return [
        f"{format_extreme(low)} / {format_extreme(high)}"
        for low, high in itertools.combinations(PARAMETER_EXTREMES[parameter], 2)
    ]


def _compute_sensitivity_indices(
    ends: Sequence[list[xr.Dataset]], quantity: str, floors: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices between all pairs of spectra, shape (waters, pairs, floors)."""
    pairs = list(itertools.combinations(ends, 2))
    value = np.empty((2, len(WATER_TABLES), len(pairs), len(floors)))
    for w, p, f in np.ndindex(value.shape[1:]):
        y, z = (end[w] for end in pairs[p])
        index = compute_spectral_sensitivity(y, z, quantity, floors[f])
        value[:, w, p, f] = index.index, index.stderr
    return value[0], value[1]


STAGES: dict[str, Callable[[InterpretationRun], StatementValues]] = {
    "distance": _compute_grain_distance,
    "table 3": _compute_table3,
    "facetness": _make_sensitivity_stage(("facetness",), ("r",)),
    "angles": compute_incidence_trends,
    "transmittance": _compute_max_transmittance,
    "facetness below": _make_sensitivity_stage(("facetness",), ("t",)),
    "grain size": _make_sensitivity_stage(("grain_size",), ("r", "t")),
    "nadir": compute_nadir_trends,
    "grains": compute_grain_trends,
    "free ranges": _make_sensitivity_stage(("saturation", "density"), ("r", "t")),
}
"""Runs in order of decreasing information per cost; each gives our values of some statements."""

STATED_NUMBERS = {
    "distance": ("grain_distance",),
    "table 3": tuple(TABLE3_WAVELENGTHS_NM),
    "facetness": ("msi_r_facetness",),
    "transmittance": ("transmittance_max",),
    "facetness below": ("msi_t_facetness",),
    "grain size": ("msi_r_grain_size", "msi_t_grain_size"),
    "free ranges": (
        "msi_r_saturation", "msi_t_saturation", "msi_r_density", "msi_t_density",
    ),
}  # fmt: skip
"""Published numbers by stage, under their ids in the table of published numbers."""

STATED_TRENDS = {
    "angles": ("fig19_lambertian", "fig19_peak_30", "fig19_peak_60", "fig19_peak_grows"),
    "nadir": ("fig16_nadir_dark", "fig16_grows", "fig17_nadir_dark", "fig18_varies_more"),
    "grains": ("fig20_fine_least", "fig21_fine_most", "fig22_rounded_varies_most"),
}
"""Trends by stage; their names begin with the figure of the paper."""


def get_stated_trends(stage: str) -> dict[str, PublishedStatement]:
    """Return the trends of a stage."""
    return {
        name: PublishedStatement(name, f"Fig {name[3:5]}", 0.0, TREND_TOLERANCE, is_trend=True)
        for name in STATED_TRENDS.get(stage, ())
    }
