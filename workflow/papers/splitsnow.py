"""SPLITSnow (Varsa et al. 2021): its numbers, trends, Tables 1 and 3, and measured albedo."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure

from splits.plotting.grammar import (
    BAND_SIGMA,
    TWO_COLUMNS_INCHES,
    annotate_figure,
    describe_conditions,
    format_value,
    make_subplots,
    pick_colours,
    use_style,
)
from workflow.papers.statements import (
    MIN_TREND_SIGMA,
    UNRESOLVED_VERDICT,
    Estimate,
    compute_steps,
    make_monotone_row,
    make_row,
    make_significance_row,
    require,
    require_columns,
    select_least_significant,
)

DIFFUSE_FRACTION = 0.85
"""Fraction of diffuse light in the measurements of Letcher et al. (2022)."""
LETCHER_COLUMNS = {0.34: "albedo_340mm", 0.045: "albedo_45mm_black"}
"""Measured column for each depth (m) of the experiment."""
MIN_VERDICT_SIGMA = 2.0
"""Smallest distance to a tolerance limit, in standard errors, that permits a verdict."""
AT_BAR_VERDICT = "at the bar"
"""Verdict on a number whose distance to a tolerance limit and whose error are both less than one
unit of the last printed digit of the published number, so that a smaller error decides nothing.
The tolerance is larger than that unit."""
AVIRIS_BANDS_NM = {"842": 842.25, "1074": 1073.76, "1238": 1237.93}
AVIRIS_COLUMNS = ("wavelength_nm", "reflectance", "reflectance_min", "reflectance_max")
REFLECTANCE_PEAKS_NM = {1800.0: (1500.0, 2000.0), 2250.0: (2000.0, 2500.0)}
"""Wavelengths (nm) of reflectance maxima, and of the absorption bands on both sides."""


def make_agreement_table(
    *,
    published: pd.DataFrame,
    aviris: pd.DataFrame,
    letcher: pd.DataFrame,
    sensitivities: xr.Dataset,
    sample: xr.Dataset,
    thick_transmittance: xr.Dataset,
    grain_size: xr.Dataset,
    facetness: xr.Dataset,
    density: xr.Dataset,
    depth: xr.Dataset,
    grain_size_transmittance: xr.Dataset,
    saturation_transmittance: xr.Dataset,
    density_transmittance: xr.Dataset,
    scene: xr.Dataset,
    snows: xr.Dataset,
) -> pd.DataFrame:
    """Return one row per published number, trend and measured spectrum.

    Parameters
    ----------
    published : pandas.DataFrame
        See `splits.analysis.measured.read_published`.
    aviris, letcher : pandas.DataFrame
        Measured bands of the scene, and measured albedo of the snows.
    sensitivities : xarray.Dataset
        See `workflow.papers.sensitivity.make_sensitivities`.
    sample, ... : xarray.Dataset
        The runs.

    Returns
    -------
    pandas.DataFrame
        Columns id, quantity, place, published, ours, stderr, difference, bar, verdict.
    """
    visible, densities = (400.0, 700.0), ("density_kg_m3",)
    require("sample", sample, "reflectance", densities, values={"density_kg_m3": (450,)})
    require("thick_transmittance", thick_transmittance, "transmittance", band_nm=(400, 1000))
    require("density", density, "reflectance", densities, values={"density_kg_m3": (300, 450)})
    require("scene", scene, "reflectance", at_nm=tuple(AVIRIS_BANDS_NM.values()))
    require_columns("measured.aviris", aviris, AVIRIS_COLUMNS)
    density_transmittance = require(
        "density_transmittance", density_transmittance, "transmittance", densities,
        at_nm=(1420,), band_nm=visible,
    )  # fmt: skip
    trend_rows = make_snow_trend_rows(
        require(
            "grain_size", grain_size, "reflectance", ("grain_size_um",),
            at_nm=(1500, 1800, 2000, 2250, 2500), band_nm=(400, 2500),
        ),
        require("facetness", facetness, "reflectance", ("facetness",), band_nm=(700, 1300)),
        require("depth", depth, "transmittance", ("depth_m",), at_nm=(1030,), band_nm=visible),
        require(
            "grain_size_transmittance", grain_size_transmittance, "transmittance",
            ("grain_size_um",), band_nm=visible,
        ),
        require(
            "saturation_transmittance", saturation_transmittance, "transmittance",
            ("saturation",), band_nm=(400, 1450),
        ),
        density_transmittance,
    )  # fmt: skip

    distance = sample.mean_grain_distance.sel(density_kg_m3=450)
    values = {"grain_distance": Estimate(distance, 0.0)}
    for label, wavelength in AVIRIS_BANDS_NM.items():
        value = Estimate.from_dataset(scene, "reflectance").sel(wavelength=wavelength)
        values[f"table3_{label}"] = values[f"aviris_{label}"] = value
    extremes = aviris[["reflectance_min", "reflectance_max"]].to_numpy()
    model = compare_with_spectrum(scene, aviris)
    ours, error = (model[[name]].to_numpy() for name in ("model", "stderr"))
    percent = 100 * np.abs(ours - extremes) / extremes
    values["aviris_extremes"] = Estimate(percent.mean(), 100 * (error / extremes).mean())
    values["transmittance_max"] = _find_max_transmittance(thick_transmittance, 400, 500)
    values["transmittance_950"] = _find_max_transmittance(thick_transmittance, 960, 1000)
    thin = density_transmittance.isel(density_kg_m3=0).sel(wavelength=1420)
    values["transmittance_1420"] = Estimate.from_dataset(thin, "transmittance")
    values |= _compute_density_effect(density)
    index = Estimate.from_dataset(sensitivities, "msi")
    for quantity, parameter in itertools.product(
        sensitivities.quantity.values, sensitivities.parameter.values
    ):
        value = index.sel(quantity=quantity, parameter=parameter)
        values[f"msi_{quantity[0]}_{parameter}"] = value
    rows = [
        _compare_with_published(name, row, value and value.to_floats())
        for name, row in published.iterrows()
        for value in [values.get(str(name))]
    ]
    rows += trend_rows
    rows += make_ranking_rows(sensitivities)
    rows += _make_measured_rows(scene, snows, aviris, letcher)
    return pd.DataFrame(rows)


def _compare_with_published(
    name: object, row: pd.Series, value: Estimate | None
) -> dict[str, object]:
    """Return the verdict on one published number."""
    fixed = {"id": name, "quantity": row.quantity, "place": row.place, "published": row.published}
    if value is None:
        verdict = "not reproducible: the measured curve is not published as numbers"
        return {**fixed, "verdict": verdict}
    ours, stderr = value
    if isinstance(row.bar, str):
        relative = row.bar.endswith("%")
        allowed = float(row.bar.rstrip("%")) * (abs(row.published) / 100 if relative else 1.0)
        low, high = row.published - allowed, row.published + allowed
        bar = f"±{row.bar}".replace("%", " %")
    else:
        low = -np.inf if pd.isna(row.low) else row.low
        high = np.inf if pd.isna(row.high) else row.high
        bar = f"{low:g} to {high:g}" if np.isfinite(low) else f"at most {high:g}"
    verdict = "agrees" if low <= ours <= high else "outside"
    distance = min(abs(ours - low), abs(ours - high))
    if distance < MIN_VERDICT_SIGMA * stderr:
        tolerance = min(row.published - low, high - row.published)
        is_at_bar = max(distance, stderr) < row.resolution < tolerance
        verdict = AT_BAR_VERDICT if is_at_bar else UNRESOLVED_VERDICT
    numbers = {"ours": ours, "stderr": stderr, "difference": ours - row.published}
    return {**fixed, **numbers, "bar": bar, "verdict": verdict}


def _find_max_transmittance(dataset: xr.Dataset, low: float, high: float) -> Estimate:
    """Return the largest transmittance in a band (nm)."""
    part = dataset.sel(wavelength=slice(low, high))
    transmittance = Estimate.from_dataset(part, "transmittance")
    return transmittance.isel(wavelength=part.transmittance.argmax("wavelength"))


def _compute_density_effect(dataset: xr.Dataset) -> dict[str, Estimate]:
    spectra = [dataset.sel(density_kg_m3=density) for density in (300, 450)]
    loose, dense = (Estimate.from_dataset(part, "reflectance") for part in spectra)
    difference, error = (part.values for part in dense - loose)
    percent = 100 * np.abs(difference) / loose.value.values

    def compute_stderr(weights: np.ndarray) -> float:
        weight = xr.DataArray(weights, dims="wavelength")
        return math.hypot(*(s.errors.weighted_sum("reflectance", weight)[1] for s in spectra))

    weights = np.sign(difference) / (loose.value.values * difference.size)
    return {
        "density_rmse": Estimate(*compute_rmse(difference, error, compute_stderr)),
        "density_percent": Estimate(percent.mean(), 100 * compute_stderr(weights)),
    }


def _make_measured_rows(
    scene: xr.Dataset, snows: xr.Dataset, aviris: pd.DataFrame, letcher: pd.DataFrame
) -> list[dict[str, object]]:
    """Return the RMSE to measured spectra, to which nothing was fitted."""
    _require_snows(snows, letcher)
    results = [("AVIRIS-NG, 3 bands", "Table 3", compute_measured_rmse(scene, aviris))]
    for snow, depth in itertools.product(snows.medium.values, LETCHER_COLUMNS):
        column = select_letcher_column(letcher, depth)
        rmse = compute_measured_rmse(mix_letcher_illumination(snows, snow, depth), column)
        description = f"Letcher et al. (2022), {1e3 * depth:g} mm, {snow}"
        results.append((description, "The Cryosphere 16, 4343", rmse))
    return [
        {
            "id": "measured", "quantity": f"RMSE to measured reflectance: {description}",
            "place": place, "ours": value, "stderr": error, "bar": "at most 0.03",
            "verdict": "agrees" if value <= 0.03 else "outside",
        }
        for description, place, (value, error) in results
    ]  # fmt: skip


TABLE1_LABELS = {
    "snow_grain_size_um": "grain size min, max (µm)",
    "snow_saturation": "water saturation",
    "snow_facetness": "facetness min, max, mean, sd",
    "snow_sphericity": "sphericity min, max, mean, sd",
    "snow_temperature_c": "temperature (°C)",
    "snow_depth_m": "depth (m)",
    "incidence_deg": "angle of incidence (°)",
}


def make_table1(*, sample: xr.Dataset) -> pd.DataFrame:
    """Return the inputs and derived quantities of the representative sample (Table 1)."""
    sample = require("sample", sample, "reflectance", ("density_kg_m3",))
    rows = [
        (label, ", ".join(f"{v:g}" for v in np.atleast_1d(sample.attrs[key])))
        for key, label in TABLE1_LABELS.items()
    ]
    for density in sample.density_kg_m3.values:
        part = sample.sel(density_kg_m3=density)
        distance = 1e3 * float(part.mean_grain_distance)
        rows.append((f"mean grain distance at {density:g} kg m⁻³ (mm)", f"{distance:.4f}"))
    area = float(sample.specific_surface_area.isel(density_kg_m3=0))
    rows.append(("specific surface area (m² kg⁻¹)", f"{area:.2f}"))
    return pd.DataFrame(rows, columns=["quantity", "value"])


def make_table3(
    *, interpretation: xr.Dataset, aviris: pd.DataFrame, published: pd.DataFrame
) -> pd.DataFrame:
    """Return measured, published and our reflectance in the AVIRIS-NG bands (Table 3).

    Parameters
    ----------
    interpretation : xarray.Dataset
        Reflectance over ``wavelength`` and ``interpretation``.
    aviris : pandas.DataFrame
        Measured bands.
    published : pandas.DataFrame
        See `splits.analysis.measured.read_published`.
    """
    bands = tuple(AVIRIS_BANDS_NM.values())
    interpretation = require(
        "interpretation", interpretation, "reflectance", ("interpretation",), at_nm=bands
    )
    require_columns("measured.aviris", aviris, AVIRIS_COLUMNS)
    names = [f"table3_{band}" for band in AVIRIS_BANDS_NM]
    require_columns("published.published", published, names)
    tables = []
    for name in interpretation.interpretation.values:
        table = compare_with_spectrum(interpretation.sel(interpretation=name), aviris)
        table.insert(0, "interpretation", name)
        table["relative_difference_percent"] = 100 * table.difference / table.measured
        table["published_model"] = published.loc[names].published.to_numpy()
        table["difference_to_published"] = table.model - table.published_model
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def make_snow_trend_rows(
    sizes: xr.Dataset,
    facets: xr.Dataset,
    depths: xr.Dataset,
    sizes_below: xr.Dataset,
    saturations: xr.Dataset,
    densities: xr.Dataset,
) -> list[dict[str, object]]:
    """Return one row per trend: the smallest step in the stated direction, with its error.

    Reflectance by grain size and facetness; transmittance by depth, grain size, saturation and
    density.
    """
    quantity, ends = "transmittance", saturations.isel(saturation=[0, -1])
    return [
        make_monotone_row(sizes, "reflectance", "grain_size_um", -1, (700, 1300),
            "reflectance falls with grain size, 700-1300 nm", "Fig 8"),
        make_monotone_row(depths, quantity, "depth_m", -1, (400, 700),
            "transmittance falls with depth, 400-700 nm", "Fig 11"),
        make_monotone_row(sizes_below, quantity, "grain_size_um", +1,
            (400, 700), "transmittance rises with grain size, 400-700 nm", "Fig 12"),
        make_monotone_row(saturations, quantity, "saturation", +1, (400, 700),
            "transmittance rises with saturation, 400-700 nm", "Fig 13"),
        make_monotone_row(saturations, quantity, "saturation", -1, (800, 1450),
            "transmittance falls with every step of saturation, mean over 800-1450 nm", "Fig 13"),
        make_monotone_row(ends, quantity, "saturation", -1, (800, 1450),
            "transmittance falls from 0 to 30 % saturation, mean over 800-1450 nm", "Fig 13"),
        make_monotone_row(saturations, quantity, "saturation", -1, (940, 1450),
            "transmittance falls with saturation, 940-1450 nm", "Fig 13"),
        make_monotone_row(densities, quantity, "density_kg_m3", -1,
            (400, 700), "transmittance falls with density, 400-700 nm", "Fig 14"),
        *_make_facetness_rows(facets),
        _make_band_comparison_row(sizes),
        *(_make_peak_row(sizes, peak, *valleys) for peak, valleys in REFLECTANCE_PEAKS_NM.items()),
        *_make_depth_rows(depths),
    ]  # fmt: skip


def make_ranking_rows(sensitivities: xr.Dataset) -> list[dict[str, object]]:
    """Return one row per step of the ranking of sensitivities of reflectance (Table 2)."""
    index = Estimate.from_dataset(sensitivities.sel(quantity="reflectance"), "msi")
    rows = []
    for stronger, weaker in (
        ("grain_size", "facetness"), ("grain_size", "density"), ("saturation", "density"),
        ("facetness", "density"),
    ):  # fmt: skip
        statement = f"MSI of reflectance: {stronger} above {weaker}".replace("_", " ")
        difference = index.sel(parameter=stronger) - index.sel(parameter=weaker)
        rows.append(make_significance_row(statement, "Table 2", *difference))
    return rows


def _make_facetness_rows(dataset: xr.Dataset) -> list[dict[str, object]]:
    """Return the rows on the rise of reflectance with facetness: whole range and smallest step.

    The rise flattens, so that neighbouring values may agree within their errors; the second row
    only requires that no step is significantly negative.
    """
    mean = Estimate(*dataset.errors.mean("reflectance", 700, 1300))
    value, error = select_least_significant(*mean.diff("facetness"))
    rises = "reflectance rises from least to most facetness, 700-1300 nm"
    never_falls = "reflectance never falls with facetness, 700-1300 nm: smallest step"
    is_met, bar = value > -MIN_TREND_SIGMA * error, f"above -{MIN_TREND_SIGMA:g} standard errors"
    rise = mean.isel(facetness=[0, -1]).diff("facetness")
    return [
        make_significance_row(rises, "Fig 9", *rise),
        make_row(never_falls, "Fig 9", value, error, is_met, bar),
    ]


def _make_band_comparison_row(dataset: xr.Dataset) -> dict[str, object]:
    """Return the comparison of the decrease with grain size in 700-1300 nm and in 400-700 nm."""
    ends = dataset.isel(grain_size_um=[0, -1])
    infrared, visible = (
        compute_steps(ends, "reflectance", "grain_size_um", *band)
        for band in ((700, 1300), (400, 700))
    )
    statement = "reflectance falls more with grain size in 700-1300 nm than in 400-700 nm"
    return make_significance_row(statement, "Fig 8", *visible - infrared)


def _make_peak_row(
    dataset: xr.Dataset, peak: float, left: float, right: float
) -> dict[str, object]:
    part = dataset.sel(wavelength=[left, peak, right])
    r, e = part.reflectance.values, part.reflectance_stderr.values
    height = np.minimum(r[..., 1] - r[..., 0], r[..., 1] - r[..., 2])
    statement = f"reflectance peaks at {peak:g} nm between {left:g} and {right:g} nm"
    error = np.linalg.norm(e, axis=-1)
    return make_significance_row(f"{statement}: smallest height", "Fig 8", height, error)


def _make_depth_rows(dataset: xr.Dataset) -> list[dict[str, object]]:
    """Return the rows on transmittance at twice the depth, in the visible and at 1030 nm."""
    visible = Estimate(*dataset.errors.mean("transmittance", 400, 700)).divide_neighbours("depth_m")
    infrared = Estimate.from_dataset(dataset.sel(wavelength=1030), "transmittance")
    rows = []
    for depth, ratio, error in zip(dataset.depth_m.values, *visible, strict=False):
        depths = f"{2e3 * depth:g} mm over {1e3 * depth:g} mm"
        statement = f"transmittance, 400-700 nm, {depths}: approximately half"
        is_met, bar = bool(0.35 <= ratio <= 0.65), "0.35 to 0.65"
        rows.append(make_row(statement, "Fig 11", ratio, error, is_met, bar))
    excess = (visible - infrared.divide_neighbours("depth_m")).isel(depth_m=0)
    statement = "doubling the depth cuts transmittance more at 1030 nm than in 400-700 nm"
    return [*rows, make_significance_row(statement, "Fig 11", *excess)]


def compare_with_spectrum(dataset: xr.Dataset, measured: pd.DataFrame) -> pd.DataFrame:
    """Return modelled and measured reflectance at the measured wavelengths.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``reflectance`` and its error over ``wavelength`` only, including every measured one.
    measured : pandas.DataFrame
        Columns ``wavelength_nm`` and ``reflectance``.
    """
    part = dataset.sel(wavelength=measured.wavelength_nm.values)
    return pd.DataFrame(
        {
            "wavelength_nm": measured.wavelength_nm,
            "measured": measured.reflectance,
            "model": part.reflectance.values,
            "stderr": part.reflectance_stderr.values,
            "difference": part.reflectance.values - measured.reflectance,
        }
    )


def compute_measured_rmse(dataset: xr.Dataset, measured: pd.DataFrame) -> tuple[float, float]:
    """Return the root-mean-square difference from a measured reflectance, and its error.

    Parameters
    ----------
    dataset, measured
        As for `compare_with_spectrum`.
    """
    table = compare_with_spectrum(dataset, measured)
    part = dataset.sel(wavelength=measured.wavelength_nm.values)

    def compute_stderr(weights: np.ndarray) -> float:
        by_wavelength = xr.DataArray(weights, dims="wavelength")
        return float(part.errors.weighted_sum("reflectance", by_wavelength)[1])

    return compute_rmse(table.difference, table.stderr, compute_stderr)


def compute_rmse(
    difference: np.ndarray, stderr: np.ndarray, compute_stderr: Callable[[np.ndarray], float]
) -> tuple[float, float]:
    """Return the root mean square of differences and its standard error.

    Parameters
    ----------
    difference, stderr : float, shape (wavelengths,)
        Differences and their standard errors.
    compute_stderr : callable
        From weights, shape (wavelengths,), to the standard error of the weighted sum of
        differences, with the correlation of errors along the spectrum.

    Notes
    -----
    δ rmse = Σ d δd / (n rmse).  Noise additionally increases rmse by half its mean square
    over rmse. The root mean square of the errors is an upper bound for any correlation.
    """
    difference, stderr = (np.asarray(x, dtype=float) for x in (difference, stderr))
    value = float(np.sqrt(np.mean(difference**2)))
    bound = float(np.sqrt(np.mean(stderr**2)))
    if value == 0.0:
        return value, bound
    linear = compute_stderr(difference / (difference.size * value))
    return value, float(min(np.hypot(linear, 0.5 * bound**2 / value), bound))


def select_letcher_column(measured: pd.DataFrame, depth: float) -> pd.DataFrame:
    """Return the spectrum measured on snow of a depth (m), for `compare_with_spectrum`."""
    return measured.rename(columns={LETCHER_COLUMNS[depth]: "reflectance"})


def mix_letcher_illumination(dataset: xr.Dataset, snow: str, depth: float) -> xr.Dataset:
    """Return the reflectance of snow under the illumination of the measurement, with its errors.

    `DIFFUSE_FRACTION` of the light is diffuse and the rest a beam.
    """
    part = dataset.sel(medium=snow).sel(depth_m=depth, method="nearest")
    illuminations = [(1.0 - DIFFUSE_FRACTION, "beam"), (DIFFUSE_FRACTION, "diffuse")]
    runs = [(fraction, part.sel(incidence_deg=incidence)) for fraction, incidence in illuminations]
    squares = [(fraction * run.reflectance_stderr) ** 2 for fraction, run in runs]
    batches = [fraction * run.reflectance_batches for fraction, run in runs]
    scalar_names = ("medium", "incidence_deg", "depth_m")
    return xr.Dataset(
        {
            "reflectance": sum(
                fraction * run.reflectance.drop_vars(scalar_names) for fraction, run in runs
            ),
            "reflectance_stderr": sum(square.drop_vars(scalar_names) for square in squares) ** 0.5,
            "reflectance_batches": xr.concat([g.drop_vars(scalar_names) for g in batches], "batch"),
        }
    )


def _require_snows(snows: xr.Dataset, letcher: pd.DataFrame) -> None:
    """Reject runs and measured columns other than those of the measurement."""
    axes = ("medium", "depth_m", "incidence_deg")
    values: dict[str, tuple[float | str, ...]] = {
        "depth_m": tuple(LETCHER_COLUMNS), "incidence_deg": ("beam", "diffuse"),
    }  # fmt: skip
    require("snows", snows, "reflectance", axes, values=values)
    require_columns("measured.letcher", letcher, ("wavelength_nm", *LETCHER_COLUMNS.values()))


def compare_with_letcher(*, snows: xr.Dataset, letcher: pd.DataFrame) -> pd.DataFrame:
    """Return modelled and measured albedo for every snow and depth of the experiment."""
    _require_snows(snows, letcher)
    tables = []
    for snow, depth in itertools.product(snows.medium.values, LETCHER_COLUMNS):
        table = compare_with_spectrum(
            mix_letcher_illumination(snows, snow, depth), select_letcher_column(letcher, depth)
        )
        table.insert(0, "snow", str(snow))
        table.insert(1, "depth_m", depth)
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def draw_measured_albedo(*, snows: xr.Dataset, letcher: pd.DataFrame) -> Figure:
    """Draw measured albedo and that of modelled snows."""
    table = compare_with_letcher(snows=snows, letcher=letcher)
    return draw_albedo(table, describe_conditions(snows))


def draw_albedo(table: pd.DataFrame, note: str = "") -> Figure:
    """Draw measured and modelled albedo and their difference, a column per depth.

    Parameters
    ----------
    table : pandas.DataFrame
        See `compare_with_letcher`.
    note : str
        Note for the foot, see `splits.plotting.grammar.describe_conditions`.
    """
    depths = sorted(table.depth_m.unique(), reverse=True)
    with use_style():
        figure, panels = make_subplots(
            2, len(depths), width=TWO_COLUMNS_INCHES, height=3.9, sharex=True, sharey="row",
            gridspec_kw={"height_ratios": [2, 1]},
        )  # fmt: skip
        for column, depth in enumerate(depths):
            top, bottom = panels[:, column]
            part = table[table.depth_m == depth]
            groups = list(part.groupby("snow", sort=False))
            for (snow, rows), colour in zip(
                groups, pick_colours(len(groups), "medium"), strict=True
            ):
                x, error = rows.wavelength_nm, BAND_SIGMA * rows.stderr
                top.errorbar(x, rows.model, error, color=colour, label=format_value(snow))
                bottom.errorbar(x, rows.difference, error, color=colour)
            first = groups[0][1]
            top.plot(first.wavelength_nm, first.measured, "ks", ms=2.5, label="measured")
            bottom.axhline(0, color="black", lw=0.6)
            top.set_title(f"depth: {1e3 * depth:g} mm" + (" over black" if depth < 0.1 else ""))
            top.set_ylim(0, 1.05)
            bottom.set_xlabel("wavelength (nm)")
        panels[0, 0].set_ylabel("albedo")
        panels[1, 0].set_ylabel("model − measured")
        panels[0, 1].legend(frameon=False)
        return annotate_figure(figure, panels.flat, note)
