"""SPLITS (Kimmel & Baranoski 2007): trends, colours and compositions of sand."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd
import xarray as xr

from splits.analysis.colour import make_colour_table
from splits.experiments.config.simulation import SimulationConfig
from splits.media.sand_composition import SandComposition
from workflow.papers.statements import (
    Estimate,
    make_monotone_row,
    make_significance_row,
    require,
)

RISING_BANDS_NM = ((400, 500), (500, 600), (600, 700), (700, 1000))
RED_BAND_NM, GREEN_BAND_NM = (620, 700), (480, 560)


def make_sand_trend_table(
    *,
    samples: xr.Dataset,
    wet_colours: xr.Dataset,
    iron_oxide: xr.Dataset,
    hematite_ratio: xr.Dataset,
    magnetite: xr.Dataset,
    texture: xr.Dataset,
    fine_fraction: xr.Dataset,
) -> pd.DataFrame:
    """Return one row per trend: the smallest step in the stated direction, with its error.

    Returns
    -------
    pandas.DataFrame
        Columns id, quantity, place, ours, stderr, bar, verdict.
    """

    def make_row(
        key: str, run: xr.Dataset, axis: str, sign: int, band: tuple[float, float],
        statement: str, place: str, axes: tuple[str, ...] = (),
    ) -> dict[str, object]:  # fmt: skip
        run = require(key, run, "reflectance", (*axes, axis), band_nm=band)
        return make_monotone_row(run, "reflectance", axis, sign, band, statement, place)

    samples = require("samples", samples, "reflectance", ("medium",), band_nm=(400, 1000))
    hematite_ratio = require(
        "hematite_ratio", hematite_ratio, "reflectance", ("hematite_ratio",), band_nm=(480, 700)
    )
    rows = [
        *_make_rise_rows(samples),
        make_row("iron_oxide", iron_oxide, "iron_oxide", -1, (400, 1000),
                 "reflectance falls with hematite and goethite, 400-1000 nm", "Fig 8"),
        _make_reddening_row(hematite_ratio),
        make_row("magnetite", magnetite, "magnetite", -1, (400, 1000),
                 "reflectance falls with magnetite, 400-1000 nm", "Fig 8"),
        make_row("texture", texture, "texture", +1, (400, 1000),
                 "reflectance rises with silt for sand: smaller particles are brighter", "Fig 8"),
        make_row("wet_colours", wet_colours, "saturation", -1, (400, 780),
                 "all four samples darken with saturation, 400-780 nm", "Figs 7, 10", ("medium",)),
        make_row("fine_fraction", fine_fraction, "texture", +1, (400, 500),
                 "reflectance rises with clay for silt, 400-500 nm", "section 5.2"),
    ]  # fmt: skip
    return pd.DataFrame(rows)


def _make_rise_rows(samples: xr.Dataset) -> list[dict[str, object]]:
    errors = samples.errors
    means = [errors.mean("reflectance", *band)[0] for band in RISING_BANDS_NM]
    weights = [errors.make_band_weights(*band) for band in RISING_BANDS_NM]
    step, weight = (xr.concat(parts, "band").diff("band") for parts in (means, weights))
    steps = Estimate(step, errors.weighted_sum("reflectance", weight)[1])
    bands = ", ".join(f"{low}-{high}" for low, high in RISING_BANDS_NM)
    return [
        make_significance_row(
            f"reflectance of {sample} rises over bands {bands} nm: smallest step",
            "section 2.1, Fig 6", *steps.sel(medium=sample),
        )
        for sample in samples.medium.values
    ]  # fmt: skip


def _make_reddening_row(dataset: xr.Dataset) -> dict[str, object]:
    """Return the row on the increase of the ratio of red to green reflectance with hematite."""
    errors, bands = dataset.errors, (RED_BAND_NM, GREEN_BAND_NM)
    red, green = (errors.mean("reflectance", *band)[0] for band in bands)
    red_weights, green_weights = (errors.make_band_weights(*band) for band in bands)
    ratio, slope = red / green, red_weights / red - green_weights / green
    error = ratio * errors.weighted_sum("reflectance", slope)[1]
    statement = "hematite for goethite shifts to the red: ratio of 620-700 to 480-560 nm"
    steps = Estimate(ratio, error).diff("hematite_ratio")
    return make_significance_row(f"{statement}, smallest step", "Fig 8", *steps)


def make_weight_table(
    *, mineral_weight: xr.Dataset, interpretation: xr.Dataset, size_tail: xr.Dataset
) -> pd.DataFrame:
    """Return the shifts of the reflectance of sands if one input is changed."""
    return pd.concat(
        [
            make_shift_table("mineral_weight", mineral_weight, "refractive_index", "as modelled"),
            make_shift_table("interpretation", interpretation, "interpretation", "default"),
            make_shift_table("size_tail", size_tail, "size_tail", 1e-4),
        ]
    )


def make_colours(*, wet_colours: xr.Dataset, colours: xr.Dataset) -> pd.DataFrame:
    """Return the colours of dry and wet sand (Figs 7 and 9)."""
    runs = [
        require(key, run, "reflectance", axes, band_nm=(400, 780))
        for key, run, axes in (
            ("wet_colours", wet_colours, ("medium", "saturation")),
            ("colours", colours, ("medium",)),
        )
    ]
    tables = [make_colour_table(run).assign(experiment=run.attrs["experiment"]) for run in runs]
    return pd.concat(tables)


def make_shift_table(
    key: str, dataset: xr.Dataset, dimension: str, reference: str | float
) -> pd.DataFrame:
    """Return the shifts of reflectance from a reference along one dimension of a grid.

    Parameters
    ----------
    key : str
        Name of the study input.
    dataset : xarray.Dataset
        ``reflectance`` and its error over ``medium``, `dimension` and wavelength.
    dimension : str
    reference : str or float
        Value of `dimension` to compare with.

    Returns
    -------
    pandas.DataFrame
        Per medium and value the mean shift and the largest absolute shift with their errors, and
        the wavelength of the latter.
    """
    axes = ("medium", dimension)
    dataset = require(key, dataset, "reflectance", axes, values={dimension: (reference,)})
    low, high = dataset.wavelength.values[[0, -1]]
    spectrum, mean = (
        estimate - estimate.sel(**{dimension: reference})
        for estimate in (
            Estimate.from_dataset(dataset, "reflectance"),
            Estimate(*dataset.errors.mean("reflectance", low, high)),
        )
    )
    worst = spectrum.isel(wavelength=abs(spectrum.value).argmax("wavelength"))
    columns = {
        "varied": dimension, "value": worst.value[dimension], "mean_shift": mean.value,
        "mean_shift_stderr": mean.stderr, "largest_shift": worst.value,
        "largest_shift_stderr": worst.stderr, "at_wavelength_nm": worst.value.wavelength,
    }  # fmt: skip
    grid = xr.Dataset(columns).reset_coords(drop=True)
    table = grid.to_dataframe(["medium", dimension])[list(columns)].reset_index("medium")
    return table[table.value != reference].reset_index(drop=True)


def make_composition_table(experiments: Mapping[str, SimulationConfig]) -> pd.DataFrame:
    """Return the intermediate quantities of SPLITS section 4.2.5, a row per particle type and sand.

    Parameters
    ----------
    experiments : mapping
        By name; those without sand have no rows.  Points of a grid with equal compositions appear
        once per experiment.

    Returns
    -------
    pandas.DataFrame
        Columns experiment, sample, iron_oxide, hematite_ratio, magnetite, sand_density_kg_m3, and
        those of `splits.media.sand_composition.SandComposition.to_rows`.
    """
    rows: list[dict[str, object]] = []
    sands = {n: one for n, one in experiments.items() if one.medium.get("kind") == "sand"}
    for name, experiment in sands.items():
        seen: list[SandComposition] = []
        medium: Any
        for labels, medium, _ in experiment.iter_points():
            composition = getattr(medium, "composition", None)
            if composition is None or composition in seen:
                continue
            seen.append(composition)
            sample = {
                "experiment": name,
                "sample": " · ".join(f"{p} {label}" for p, label in labels.items()),
                "iron_oxide": medium.iron_oxide,
                "hematite_ratio": medium.hematite_ratio,
                "magnetite": medium.magnetite,
                "sand_density_kg_m3": medium.density_kg_m3,
            }
            rows += [sample | row for row in composition.to_rows()]
    return pd.DataFrame(rows)
