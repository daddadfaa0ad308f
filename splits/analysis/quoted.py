"""Numbers that README and docs quote from a run, each under the key of its marks.

`splits.analysis.marks` says how documents hold them.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.analysis.angular_trends import LAMBERTIAN
from splits.analysis.directions import principal_plane
from splits.analysis.quoted_retrievals import RETRIEVALS
from splits.analysis.quoted_times import TIMES
from splits.analysis.quoting import Number, Value, Where, cell, count, extreme, point, size
from splits.checks import refuse
from splits.dataset import load
from splits.transport.grains.scene import MAX_REJECTIONS

CODE = ""
"""In place of a source: the number is a constant of the code."""
OPTIONAL = "benchmarks/"
"""Folder of sources that a run need not have made."""
LABELS: Any = {"low": str, "high": str, "value": str}
"""Columns that hold labels of grids, some of them numbers."""

AGREEMENT, TABLE3 = "tables/agreement.csv", "tables/table3.csv"
SENSITIVITY, WEIGHTS = "tables/sensitivity.csv", "tables/sand_weights.csv"
FITS, LAYERS = "tables/sand_fit_parameters.csv", "tables/layer_trends.csv"
LENS, GLASS = "data/layer_fig02_lens.nc", "data/layer_fig03_glass.nc"
OURS = ("ours", "stderr")
MSI = ("msi", "msi_stderr")


def quoted(results: str | Path) -> dict[str, str]:
    """Return the texts of all numbers of `NUMBERS` that a run has made.

    Parameters
    ----------
    results : path
        Folder of a run's results; its benchmarks may be missing.

    Raises
    ------
    ValueError
        If another source is missing, or does not hold a number once.
    """
    results = Path(results)
    sources: dict[str, Any] = {CODE: None}
    texts = {}
    for key, number in NUMBERS.items():
        path = results / number.source
        if number.source not in sources:
            if number.source.startswith(OPTIONAL) and not path.exists():
                continue
            if not path.exists():
                raise refuse("results", str(path), "there", "snakemake --cores 2 makes it")
            is_table = path.suffix == ".csv"
            sources[number.source] = pd.read_csv(path, dtype=LABELS) if is_table else load(path)
        try:
            texts[key] = number.format_text(sources[number.source])
        except (KeyError, ValueError) as error:
            raise ValueError(f"{path}: {key}: {error}") from None
    return texts


def _snow() -> dict[str, Number]:
    """Agreement with published numbers and measured spectra."""
    letcher = "RMSE to measured reflectance: Letcher et al. (2022), "
    rise = "reflectance rises from least to most facetness"
    found: dict[str, Number] = {
        "distance": Number(AGREEMENT, cell("ours", id="grain_distance"), ".2e"),
        "transmittance": Number(AGREEMENT, cell(*OURS, scale=100.0, id="transmittance_max"), ".1f"),
        "density.rmse": Number(AGREEMENT, cell(*OURS, id="density_rmse")),
        "facetness.rise": Number(AGREEMENT, cell(*OURS, quantity=rise)),
    }
    snows = {
        "natural": "natural snow", "paper": "Table 1, splitsnow_2021",
        "parent": "Table 1, splits_2007",
    }  # fmt: skip
    for depth, (name, snow) in itertools.product((45, 340), snows.items()):
        select = cell(*OURS, quantity=f"{letcher}{depth} mm, {snow}")
        found[f"letcher.{depth}.{name}"] = Number(AGREEMENT, select)
    return found | _ranking() | _surface_area()


def _ranking() -> dict[str, Number]:
    """Return misfits of the first combination of readings, and of the sets with a name."""
    table = "tables/readings_together.csv"
    water = "hale_querry_1973"
    rows: dict[str, Where] = {
        "first": {"rank": 1},
        "set": {"set": "splitsnow_2021", "water": water},
        "parent": {"set": "splits_2007", "water": water},
    }
    return {
        f"readings.{name}": Number(table, cell("misfit", "misfit_stderr", **row), ".1f")
        for name, row in rows.items()
    }


def _surface_area() -> dict[str, Number]:
    """Return surface areas of measured snow, and what 1310 nm tells of one."""
    table, law = "tables/surface_area.csv", "tables/surface_area_law.csv"
    windows = {"all": "all", "below": "below 1300 nm", "above": "above 1500 nm"}
    found = {
        f"law.{name}": Number(law, cell("reflectance", "stderr", snow=snow, area=20.0))
        for name, snow in {"natural": "natural snow", "spheres": "smooth spheres"}.items()
    }
    for name, snow in {"law.sixty": "natural snow", "law.spheres.sixty": "smooth spheres"}.items():
        found[name] = Number(law, cell("reflectance", "stderr", snow=snow, area=60.0))
    for spectrum in ("ID2081@47.66", "ID462@66.04", "ID1746@58.98"):
        name = spectrum.partition("@")[0].lower()
        for short, window in windows.items():
            select = cell("area", "area_stderr", spectrum=spectrum, window=window)
            found[f"area.{name}.{short}"] = Number(table, select, ".1f")
        whole: Where = {"spectrum": spectrum, "window": "all"}
        found[f"area.{name}.level"] = Number(table, cell("level", "level_stderr", **whole))
        found[f"area.{name}.rmse"] = Number(table, cell("rmse", **whole))
    return found


def _table3() -> dict[str, Number]:
    """Reflectance in the AVIRIS-NG bands under every reading."""
    bands = {"842": 842.25, "1074": 1073.76, "1238": 1237.93}
    readings = (
        "default", "splits_2007", "geometric", "size_semi_axis", "struck_size_uniform",
        "entry_projected", "facets_projected", "facets_unweighted", "wrong_side_lobe",
        "no_boundary_fresnel", "keep_on_last_leg",
        "skip_on_last_leg", "keep_across_boundary", "skip_across_boundary",
        "distance_with_grain",
    )  # fmt: skip
    found = {"table3.error": Number(TABLE3, size("stderr"), ".1g")}
    for band, nm in bands.items():
        default: Where = {"reading": "default", "wavelength_nm": nm}
        found |= {
            f"table3.published.{band}": Number(TABLE3, cell("published_model", **default)),
            f"table3.measured.{band}": Number(TABLE3, cell("measured", **default)),
            f"table3.percent.{band}": Number(
                TABLE3, cell("relative_difference_percent", **default), "+.1f"
            ),
        }
        for reading in readings:
            found[f"table3.{reading}.{band}"] = Number(
                TABLE3, cell("model", reading=reading, wavelength_nm=nm)
            )
    middle: Where = {"wavelength_nm": bands["1074"]}
    for name, largest in (("least", False), ("most", True)):
        found[f"table3.{name}"] = Number(TABLE3, extreme("model", largest=largest, **middle), ".2f")
    for reading in ("default", "splits_2007", "struck_size_uniform"):
        one: Where = {"reading": reading}
        found |= {
            f"table3.{reading}.off": Number(TABLE3, size("difference_to_published", **one)),
            f"table3.{reading}.percent": Number(
                TABLE3, size("relative_difference_percent", **one), ".1f"
            ),
        }
    return found


def _sensitivity() -> dict[str, Number]:
    """Mean sensitivity indices of the pairs chosen, over all readings, and of other pairs."""
    chosen = {
        "grain_size": ("100-200", "900-1000"),
        "saturation": ("0.0", "1.0"),
        "facetness": ("0.1", "0.9"),
        "density": ("100.0", "500.0"),
    }
    others = [("saturation", "0.0", high) for high in ("0.05", "0.1", "0.3", "0.5")]
    others.append(("density", "200.0", "400.0"))
    asked = point("max_stderr", attribute=True)
    found = {"msi.error": Number("data/sensitivity_grain_size.nc", asked)}
    for quantity in ("reflectance", "transmittance"):
        q = f"msi.{quantity[0]}"
        for parameter, (low, high) in chosen.items():
            one: Where = {"quantity": quantity, "parameter": parameter, "low": low, "high": high}
            default = cell(*MSI, reading="default", **one)
            found[f"{q}.{parameter}"] = Number(SENSITIVITY, default, ".2f")
            for name, largest in (("least", False), ("most", True)):
                select = extreme(*MSI, largest=largest, name="reading", **one)
                found[f"{q}.{parameter}.{name}"] = Number(SENSITIVITY, select, ".2f")
        for parameter, low, high in others:
            one = {"quantity": quantity, "parameter": parameter, "low": low, "high": high}
            select = cell(*MSI, reading="default", **one)
            found[f"{q}.{parameter}.{high.removesuffix('.0')}"] = Number(SENSITIVITY, select, ".2f")
    return found


def _sand() -> dict[str, Number]:
    """Weight of data and readings, the fine fraction, and misfits to measured spectra."""
    varied = {
        "refractive_index": {
            "goethite.half": "goethite k / 2",
            "goethite.twice": "goethite k x 2",
            "kaolinite.half": "kaolinite k / 2",
            "kaolinite.twice": "kaolinite k x 2",
            "hematite": "hematite ordinary ray",
        },
        "size_tail": {"tail.less": "1e-05", "tail.more": "0.001"},
        "readings": {
            name: name
            for name in (
                "mixing_linear", "sizes_single", "entry_projected", "facets_unweighted",
                "wrong_side_mirrored", "attenuation_printed", "excess_magnetite_clipped",
                "keep_on_last_leg", "keep_across_boundary",
            )
        },
    }  # fmt: skip
    samples = ("Fig 8 base", "TEC 10019201", "TEC 10039240", "TEC 13j9823", "TEC 19au9815")
    found = {"sand.error": Number(WEIGHTS, size("mean_shift_stderr"))}
    for sample in samples:
        for dimension, values in varied.items():
            for name, value in values.items():
                shift = cell("mean_shift", medium=sample, varied=dimension, value=value)
                found[f"sand.{name}.{sample.split()[-1]}"] = Number(WEIGHTS, shift, "+.3f")
    for name, texture in (("none", "no clay"), ("tenth", "0.1 % clay"), ("one", "1 % clay")):
        fines = point("reflectance", texture=texture, wavelength=400.0)
        found[f"fines.{name}"] = Number("data/sand_fine_fraction.nc", fines, ".2f")
    goethites = {"modelled": "as modelled", "half": "goethite k / 2", "twice": "goethite k x 2"}
    soils = ("quartzipsamment_87P706", "torripsamment_90P0142", "camborthid_89P1772")
    for name, goethite in goethites.items():
        for soil in soils:
            misfit = cell("rmse", refractive_index=goethite, sample=soil, parameter="iron_oxide")
            found[f"misfit.{name}.{soil.split('_')[0]}"] = Number(FITS, misfit)
    modelled: Where = {"refractive_index": "as modelled"}
    determined: Where = {"verdict": "determined"}
    return found | {
        "misfit.least": Number(FITS, extreme("rmse", largest=False, **modelled)),
        "misfit.most": Number(FITS, extreme("rmse", **modelled)),
        "misfit.error": Number(FITS, size("rmse_stderr")),
        "fits.all": Number(FITS, count(), ".0f"),
        "fits.determined": Number(FITS, count(**determined), ".0f"),
        "fits.iron_oxide": Number(FITS, count(parameter="iron_oxide", **determined), ".0f"),
        "fits.clay": Number(FITS, count(parameter="clay", **determined), ".0f"),
    }


def _angles_and_layers() -> dict[str, Number]:
    """Spread of a beam, rough surfaces, and what polarization changes."""
    found = {"lambertian": Number(CODE, lambda _: (LAMBERTIAN, None, ""), ".1f")}
    spread = "data/beam_spread.nc"
    for nm in (600, 1300):
        for name, share in (("half", 0.5), ("most", 0.9)):
            at: Where = {"side": "reflected", "wavelength": float(nm), "quantile": share}
            found[f"beam.{nm}.{name}"] = Number(spread, point("quantile_radius", 1e3, **at), ".1f")
    found["beam.incidence"] = Number(spread, point("incidence_deg", attribute=True), "g")
    limits = "data/layer_band_limit.nc"
    for limit in ("5", "15", "50", "150", "500"):
        reflectance = point("reflectance", error=False, surface=limit)
        found[f"band.{limit}"] = Number(limits, reflectance, ".4f")
    found["band.error"] = Number(
        limits, lambda dataset: (float(dataset.reflectance_stderr.max()), None, ""), ".1g"
    )
    for depth in (15, 35):
        lens = point("concentration", screen_depth=float(depth))
        found[f"lens.{depth}"] = Number(LENS, lens, ".2f")
    found["lens.surfaces"] = Number(LENS, point("realisations", attribute=True), "g")
    found["volume.surface"] = Number(GLASS, lambda glass: _glass(glass)[0])
    found["volume.nadir"] = Number(GLASS, lambda glass: _glass(glass)[1])
    for name, statement in (
        ("slopes", "same slopes correlated over 3 m"),
        ("polarization.smooth", "Rayleigh layer under smooth glass"),
        ("polarization.rough", "multiple reflections in rough glass"),
    ):
        found[name] = Number(LAYERS, cell(*OURS, scale=100.0, quantity=statement), ".0f")
    return found


def _glass(dataset: xr.Dataset) -> tuple[Value, Value]:
    """Return the BRDF of very rough glass at the nadir, and what a volume adds to it."""
    nadir = principal_plane(dataset).sel(angle=0.0).squeeze()
    surface, both = (nadir.sel(medium=m) for m in ("surface only", "surface and volume"))
    added = np.hypot(both.brdf_stderr, surface.brdf_stderr)
    return (float(surface.brdf), None, ""), (float(both.brdf - surface.brdf), float(added), "")


NUMBERS = {
    **_snow(),
    **_table3(),
    **_sensitivity(),
    **_sand(),
    **_angles_and_layers(),
    **TIMES,
    **RETRIEVALS,
    "draws": Number(CODE, lambda _: (MAX_REJECTIONS, None, ""), "power"),
}
"""All numbers that documents may quote, by key."""
