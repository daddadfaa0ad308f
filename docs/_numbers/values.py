"""Numbers of README and docs from a run, by the key of their marks.

`_numbers.marks` describes the marks.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from _numbers.colour_values import COLOUR_NUMBERS
from _numbers.formatting import (
    QuotedNumber,
    QuotedValue,
    RowFilter,
    select_cell,
    select_extreme,
    select_max_magnitude,
    select_point,
    select_row_count,
)
from _numbers.ordinates_values import ORDINATES_NUMBERS
from _numbers.retrieval_values import RETRIEVAL_NUMBERS
from _numbers.time_values import TIMING_NUMBERS
from splits.analysis.directions import select_principal_plane
from splits.core.validation import invalid
from splits.io.netcdf import load
from splits.kernels.grains.spheroid import MAX_REJECTIONS
from workflow.papers.angles import MAX_LAMBERTIAN_RANGE

CODE_SOURCE = ""
"""Source of constants of the code."""
OPTIONAL_FOLDER = "benchmarks/"
"""Folder of optional sources."""
LABEL_DTYPES: Any = {"low": str, "high": str, "value": str}
"""Columns with labels of grids, which may be numbers."""

AGREEMENT_FILE, TABLE3_FILE = "tables/agreement.csv", "tables/table3.csv"
SENSITIVITY_FILE, SAND_SHIFTS_FILE = "tables/sensitivity.csv", "tables/sand_weights.csv"
ALL_SENSITIVITY_FILE = "tables/sensitivity_by_interpretation.csv"
RETRIEVED_SAND_FILE = "tables/retrieved_sand_retrieved.csv"
LAYER_TRENDS_FILE = "tables/layer_trends.csv"
LENS_FILE, GLASS_FILE = "data/layer_fig02_lens.nc", "data/layer_fig03_glass.nc"
OURS_COLUMNS = ("ours", "stderr")
MSI_COLUMNS = ("msi", "msi_stderr")


def collect_quoted_numbers(results: str | Path) -> dict[str, str]:
    """Return the texts of all numbers of `QUOTED_NUMBERS` from a run.

    Parameters
    ----------
    results : path
        Results folder of the run; its benchmarks may be missing.

    Raises
    ------
    ValueError
        If another source is missing, or does not contain a number exactly once.
    """
    results = Path(results)
    sources: dict[str, Any] = {CODE_SOURCE: None}
    texts = {}
    for key, number in QUOTED_NUMBERS.items():
        path = results / number.source
        if number.source not in sources:
            if number.source.startswith(OPTIONAL_FOLDER) and not path.exists():
                continue
            if not path.exists():
                raise invalid("results", str(path), "an existing file", "run snakemake --cores 2")
            is_table = path.suffix == ".csv"
            sources[number.source] = (
                pd.read_csv(path, dtype=LABEL_DTYPES) if is_table else load(path)
            )
        try:
            texts[key] = number.format_text(sources[number.source])
        except (KeyError, ValueError) as error:
            raise ValueError(f"{path}: {key}: {error}") from None
    return texts


def _list_snow_numbers() -> dict[str, QuotedNumber]:
    """Return the numbers of agreement with published values and measured spectra."""
    letcher = "RMSE to measured reflectance: Letcher et al. (2022), "
    rise = "reflectance rises from least to most facetness"
    numbers: dict[str, QuotedNumber] = {
        "distance": QuotedNumber(AGREEMENT_FILE, select_cell("ours", id="grain_distance"), ".2e"),
        "transmittance": QuotedNumber(
            AGREEMENT_FILE, select_cell(*OURS_COLUMNS, scale=100.0, id="transmittance_max"), ".1f"
        ),
        "density.rmse": QuotedNumber(AGREEMENT_FILE, select_cell(*OURS_COLUMNS, id="density_rmse")),
        "facetness.rise": QuotedNumber(AGREEMENT_FILE, select_cell(*OURS_COLUMNS, quantity=rise)),
    }
    snows = {
        "natural": "natural snow", "paper": "Table 1, splitsnow_2021",
        "parent": "Table 1, splits_2007",
    }  # fmt: skip
    for depth, (name, snow) in itertools.product((45, 340), snows.items()):
        select = select_cell(*OURS_COLUMNS, quantity=f"{letcher}{depth} mm, {snow}")
        numbers[f"letcher.{depth}.{name}"] = QuotedNumber(AGREEMENT_FILE, select)
    return numbers | _list_ranking_numbers() | _list_surface_area_numbers()


def _list_ranking_numbers() -> dict[str, QuotedNumber]:
    """Return the misfits of the best interpretation, and of named sets."""
    table = "tables/interpretation_ranking.csv"
    water = "hale_querry_1973"
    rows: dict[str, RowFilter] = {
        "first": {"rank": 1},
        "set": {"set": "splitsnow_2021", "water": water},
        "parent": {"set": "splits_2007", "water": water},
    }
    return {
        f"interpretation.{name}": QuotedNumber(
            table, select_cell("misfit", "misfit_stderr", **row), ".1f"
        )
        for name, row in rows.items()
    }


def _list_surface_area_numbers() -> dict[str, QuotedNumber]:
    """Return the surface areas of measured snow, and reflectance at 1310 nm."""
    table, law = "tables/surface_area.csv", "tables/surface_area_law.csv"
    windows = {"all": "all", "below": "below 1300 nm", "above": "above 1500 nm"}
    numbers = {
        f"law.{name}": QuotedNumber(law, select_cell("reflectance", "stderr", snow=snow, area=20.0))
        for name, snow in {"natural": "natural snow", "spheres": "smooth spheres"}.items()
    }
    for name, snow in {"law.sixty": "natural snow", "law.spheres.sixty": "smooth spheres"}.items():
        numbers[name] = QuotedNumber(
            law, select_cell("reflectance", "stderr", snow=snow, area=60.0)
        )
    for spectrum in ("ID2081@47.66", "ID462@66.04", "ID1746@58.98"):
        name = spectrum.partition("@")[0].lower()
        for label, window in windows.items():
            select = select_cell("area", "area_stderr", spectrum=spectrum, window=window)
            numbers[f"area.{name}.{label}"] = QuotedNumber(table, select, ".1f")
        filters: RowFilter = {"spectrum": spectrum, "window": "all"}
        numbers[f"area.{name}.scale"] = QuotedNumber(
            table, select_cell("scale", "scale_stderr", **filters)
        )
        numbers[f"area.{name}.rmse"] = QuotedNumber(table, select_cell("rmse", **filters))
    return numbers


def _list_table3_numbers() -> dict[str, QuotedNumber]:
    """Return the reflectance in the AVIRIS-NG bands for every interpretation."""
    bands = {"842": 842.25, "1074": 1073.76, "1238": 1237.93}
    interpretations = (
        "default", "splits_2007", "geometric", "size_semi_axis", "size_sampling_uniform",
        "entry_projected", "facets_projected", "facets_unweighted", "wrong_side_lobe",
        "no_boundary_fresnel", "keep_overlap_with_segment",
        "skip_overlap_with_segment", "keep_overlap_with_boundary", "skip_overlap_with_boundary",
        "mean_free_path_with_grain",
    )  # fmt: skip
    numbers = {"table3.error": QuotedNumber(TABLE3_FILE, select_max_magnitude("stderr"), ".1g")}
    for band, nm in bands.items():
        default: RowFilter = {"interpretation": "default", "wavelength_nm": nm}
        numbers |= {
            f"table3.published.{band}": QuotedNumber(
                TABLE3_FILE, select_cell("published_model", **default)
            ),
            f"table3.measured.{band}": QuotedNumber(
                TABLE3_FILE, select_cell("measured", **default)
            ),
            f"table3.percent.{band}": QuotedNumber(
                TABLE3_FILE, select_cell("relative_difference_percent", **default), "+.1f"
            ),
        }
        for interpretation in interpretations:
            numbers[f"table3.{interpretation}.{band}"] = QuotedNumber(
                TABLE3_FILE, select_cell("model", interpretation=interpretation, wavelength_nm=nm)
            )
    middle: RowFilter = {"wavelength_nm": bands["1074"]}
    for name, largest in (("least", False), ("most", True)):
        numbers[f"table3.{name}"] = QuotedNumber(
            TABLE3_FILE, select_extreme("model", largest=largest, **middle), ".2f"
        )
    for interpretation in ("default", "splits_2007", "size_sampling_uniform"):
        filters: RowFilter = {"interpretation": interpretation}
        numbers |= {
            f"table3.{interpretation}.off": QuotedNumber(
                TABLE3_FILE, select_max_magnitude("difference_to_published", **filters)
            ),
            f"table3.{interpretation}.percent": QuotedNumber(
                TABLE3_FILE, select_max_magnitude("relative_difference_percent", **filters), ".1f"
            ),
        }
    return numbers


def _list_sensitivity_numbers() -> dict[str, QuotedNumber]:
    """Return the mean sensitivity indices of chosen and other pairs, over all interpretations."""
    chosen = {
        "grain_size": ("100-200", "900-1000"),
        "saturation": ("0.0", "1.0"),
        "facetness": ("0.1", "0.9"),
        "density": ("100.0", "500.0"),
    }
    others = [("saturation", "0.0", high) for high in ("0.05", "0.1", "0.3", "0.5")]
    others.append(("density", "200.0", "400.0"))
    max_stderr = select_point("max_stderr", attribute=True)
    numbers = {"msi.error": QuotedNumber("data/sensitivity_grain_size.nc", max_stderr)}
    for quantity in ("reflectance", "transmittance"):
        prefix = f"msi.{quantity[0]}"
        for parameter, (low, high) in chosen.items():
            filters: RowFilter = {
                "quantity": quantity,
                "parameter": parameter,
                "low": low,
                "high": high,
            }
            default = select_cell(*MSI_COLUMNS, interpretation="default", **filters)
            numbers[f"{prefix}.{parameter}"] = QuotedNumber(SENSITIVITY_FILE, default, ".2f")
            for name, largest in (("least", False), ("most", True)):
                select = select_extreme(
                    *MSI_COLUMNS, largest=largest, name="interpretation", **filters
                )
                numbers[f"{prefix}.{parameter}.{name}"] = QuotedNumber(
                    ALL_SENSITIVITY_FILE, select, ".2f"
                )
        for parameter, low, high in others:
            filters = {"quantity": quantity, "parameter": parameter, "low": low, "high": high}
            select = select_cell(*MSI_COLUMNS, interpretation="default", **filters)
            numbers[f"{prefix}.{parameter}.{high.removesuffix('.0')}"] = QuotedNumber(
                SENSITIVITY_FILE, select, ".2f"
            )
    return numbers


def _list_sand_numbers() -> dict[str, QuotedNumber]:
    """Return the effects of data and interpretation, the fine fraction, and retrievals."""
    varied = {
        "refractive_index": {
            "goethite.half": "goethite k / 2",
            "goethite.twice": "goethite k x 2",
            "kaolinite.half": "kaolinite k / 2",
            "kaolinite.twice": "kaolinite k x 2",
            "hematite": "hematite ordinary ray",
        },
        "size_tail": {"tail.less": "1e-05", "tail.more": "0.001"},
        "interpretation": {
            name: name
            for name in (
                "mixing_linear", "sizes_single", "entry_projected", "facets_unweighted",
                "wrong_side_mirrored", "attenuation_printed", "excess_magnetite_clipped",
                "keep_overlap_with_segment", "keep_overlap_with_boundary",
            )
        },
    }  # fmt: skip
    samples = ("Fig 8 base", "TEC 10019201", "TEC 10039240", "TEC 13j9823", "TEC 19au9815")
    numbers = {
        "sand.error": QuotedNumber(SAND_SHIFTS_FILE, select_max_magnitude("mean_shift_stderr"))
    }
    for sample in samples:
        for dimension, values in varied.items():
            for name, value in values.items():
                shift = select_cell("mean_shift", medium=sample, varied=dimension, value=value)
                numbers[f"sand.{name}.{sample.split()[-1]}"] = QuotedNumber(
                    SAND_SHIFTS_FILE, shift, "+.3f"
                )
    for name, texture in (("none", "no clay"), ("tenth", "0.1 % clay"), ("one", "1 % clay")):
        fines = select_point("reflectance", texture=texture, wavelength=400.0)
        numbers[f"fines.{name}"] = QuotedNumber("data/sand_fine_fraction.nc", fines, ".2f")
    goethites = {"modelled": "as modelled", "half": "goethite k / 2", "twice": "goethite k x 2"}
    soils = ("quartzipsamment_87P706", "torripsamment_90P0142", "camborthid_89P1772")
    for name, goethite in goethites.items():
        for soil in soils:
            row = {"model": goethite, "sample": soil, "parameter": "iron_oxide"}
            key = f"{name}.{soil.split('_')[0]}"
            numbers[f"misfit.{key}"] = QuotedNumber(RETRIEVED_SAND_FILE, select_cell("rmse", **row))
            percent = select_cell("median", "standard deviation", 100.0, **row)
            numbers[f"iron.{key}"] = QuotedNumber(RETRIEVED_SAND_FILE, percent, ".2f")
    for name, largest in (("least", False), ("most", True)):
        extreme = select_extreme("rmse", largest=largest, model="as modelled")
        numbers[f"misfit.{name}"] = QuotedNumber(RETRIEVED_SAND_FILE, extreme)
    counts: dict[str, RowFilter] = {
        "all": {},
        "constrained": {"constrained": "yes"},
        "iron_oxide": {"constrained": "yes", "parameter": "iron_oxide"},
        "magnetite": {"constrained": "yes", "parameter": "magnetite"},
    }
    for name, where in counts.items():
        numbers[f"composition.{name}"] = QuotedNumber(
            RETRIEVED_SAND_FILE, select_row_count(**where), ".0f"
        )
    return numbers


def _list_angular_and_layer_numbers() -> dict[str, QuotedNumber]:
    """Return the numbers of beam spread, rough surfaces and polarization."""
    numbers = {
        "lambertian": QuotedNumber(CODE_SOURCE, lambda _: (MAX_LAMBERTIAN_RANGE, None, ""), ".1f")
    }
    spread = "data/snow_beam_spread.nc"
    for nm in (600, 1300):
        for name, quantile in (("half", 0.5), ("most", 0.9)):
            point: RowFilter = {"side": "reflected", "wavelength": float(nm), "quantile": quantile}
            numbers[f"beam.{nm}.{name}"] = QuotedNumber(
                spread, select_point("quantile_radius", 1e3, **point), ".1f"
            )
    numbers["beam.incidence"] = QuotedNumber(
        spread, select_point("incidence_deg", attribute=True), "g"
    )
    limits = "data/layer_band_limit.nc"
    for limit in ("5", "15", "50", "150", "500"):
        reflectance = select_point("reflectance", error=False, surface=limit)
        numbers[f"band.{limit}"] = QuotedNumber(limits, reflectance, ".4f")
    numbers["band.error"] = QuotedNumber(
        limits, lambda dataset: (float(dataset.reflectance_stderr.max()), None, ""), ".1g"
    )
    for depth in (15, 35):
        lens = select_point("concentration", screen_depth=float(depth))
        numbers[f"lens.{depth}"] = QuotedNumber(LENS_FILE, lens, ".2f")
    numbers["lens.surfaces"] = QuotedNumber(
        LENS_FILE, select_point("realizations", attribute=True), "g"
    )
    numbers["volume.surface"] = QuotedNumber(
        GLASS_FILE, lambda glass: _compute_glass_nadir(glass)[0]
    )
    numbers["volume.nadir"] = QuotedNumber(GLASS_FILE, lambda glass: _compute_glass_nadir(glass)[1])
    for name, statement in (
        ("slopes", "same slopes correlated over 3 m"),
        ("polarization.smooth", "Rayleigh layer under smooth glass"),
        ("polarization.rough", "multiple reflections in rough glass"),
    ):
        numbers[name] = QuotedNumber(
            LAYER_TRENDS_FILE, select_cell(*OURS_COLUMNS, scale=100.0, quantity=statement), ".0f"
        )
    return numbers


def _compute_glass_nadir(dataset: xr.Dataset) -> tuple[QuotedValue, QuotedValue]:
    """Return the nadir BRDF of very rough glass, and the contribution of a volume."""
    nadir = select_principal_plane(dataset).sel(angle=0.0).squeeze()
    surface, both = (nadir.sel(medium=name) for name in ("surface only", "surface and volume"))
    stderr = np.hypot(both.brdf_stderr, surface.brdf_stderr)
    return (float(surface.brdf), None, ""), (float(both.brdf - surface.brdf), float(stderr), "")


QUOTED_NUMBERS = {
    **_list_snow_numbers(),
    **_list_table3_numbers(),
    **_list_sensitivity_numbers(),
    **_list_sand_numbers(),
    **_list_angular_and_layer_numbers(),
    **COLOUR_NUMBERS,
    **TIMING_NUMBERS,
    **RETRIEVAL_NUMBERS,
    **ORDINATES_NUMBERS,
    "draws": QuotedNumber(CODE_SOURCE, lambda _: (MAX_REJECTIONS, None, ""), "power"),
}
"""All numbers of documents, by key."""
