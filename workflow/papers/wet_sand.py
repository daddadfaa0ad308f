"""Modelled and measured reflectance of wet sand by direction (Nur & Bachmann 2023)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splits.analysis.directions import select_principal_plane
from splits.core.validation import check_range, invalid
from splits.plotting.grammar import (
    BAND_SIGMA,
    SMALL_FONT_PT,
    TWO_COLUMNS_INCHES,
    annotate_figure,
    format_parameter,
    format_value,
    make_subplots,
    pick_colours,
    use_style,
)
from workflow.papers.statements import require

REFLECTANCE_FACTOR, NADIR_RATIO = "reflectance_factor", "nadir_ratio"
"""Quantities that are compared."""
MEASURED_COLUMNS = ("wavelength_nm", "polar_deg", "azimuth_deg", REFLECTANCE_FACTOR)
"""Columns of a table of measured directions, besides those named like parameters of a grid."""
VALUE_COLUMNS = ("measured", "modelled", "stderr", "isotropic")
ALL_DIRECTIONS = "all"
"""Label of the rows over all directions, instead of an angle."""
MODEL_AXIS, SAMPLE_AXIS = "interpretation", "saturation"
"""Axes of the dataset for models and for samples."""
MAX_PLANE_ANGLE_DEG = 65.0
"""Largest viewing angle of the principal plane (degrees)."""
ANGLE_MARKERS = "os^Dv<>ph*"
_HEIGHT_INCHES = 5.2


def make_anisotropy(
    *, modelled: xr.Dataset, directions: pd.DataFrame, scale: float = 1.0
) -> tuple[pd.DataFrame, pd.DataFrame, Figure]:
    """Return values by direction, differences by viewing angle, and their figure.

    `scale` is the ratio of measured reflectance factors to true ones.
    """
    modelled = require("modelled", modelled, "brdf", (MODEL_AXIS, SAMPLE_AXIS))
    check_range("options.scale", scale, 0.0, 10.0, open_low=True)
    table = compare_with_measured(modelled, directions, scale)
    misfits = summarize_by_angle(table)
    # The principal plane is shown at a wavelength common to all samples.
    by_sample = [set(part.wavelength_nm) for _, part in table.groupby(SAMPLE_AXIS)]
    shared = set.intersection(*by_sample)
    middle = float(sorted(shared or set(table.wavelength_nm))[len(shared) // 3])
    return table, misfits, draw_anisotropy(modelled, table, misfits, middle)


def compare_with_measured(
    dataset: xr.Dataset, measured: pd.DataFrame, scale: float = 1.0
) -> pd.DataFrame:
    """Return measured reflectance factors and ratios to the nadir with the modelled ones.

    A ratio to the nadir is that of the values in a direction and at the nadir of the same scan, a
    plane through the nadir.  It does not depend on the scale, and is not defined at the nadir.

    Parameters
    ----------
    dataset : xarray.Dataset
        BRDF over ``polar_deg`` and ``azimuth_deg`` (degrees), ``wavelength`` (nm) and a grid, and
        reflectance.  Axes without a column in the table are models.
    measured : pandas.DataFrame
        With `MEASURED_COLUMNS` and one column for each other axis, with values of the grid.
    scale : float
        Ratio of measured reflectance factors to true ones, by which they are divided.

    Returns
    -------
    pandas.DataFrame
        One column for each model's axis, the table's columns, ``quantity`` and `VALUE_COLUMNS`;
        ``isotropic`` is the value of an isotropic model of the same reflectance.

    Raises
    ------
    ValueError
        For a missing column, or directions outside the dataset.
    """
    if "brdf" not in dataset:
        raise invalid("dataset", dataset.attrs.get("title", "a dataset"), "with a BRDF")
    _check_columns(dataset, measured)
    parameters = [c for c in measured.columns if c not in MEASURED_COLUMNS]
    fixed_dims = ("wavelength", "polar_deg", "azimuth_deg", *parameters)
    models = [str(d) for d in dataset.brdf.dims if d not in fixed_dims]
    _check_directions(dataset, measured)
    factor, nadir, isotropic = _select_directions(dataset, measured, parameters)
    ratio = factor.modelled / nadir.modelled
    relative = np.hypot(factor.stderr / factor.modelled, nadir.stderr / nadir.modelled)
    ratios = xr.Dataset({"modelled": ratio, "stderr": ratio * relative})
    measured_ratio = _compute_nadir_ratio(measured, parameters)
    parts = []
    for quantity, modelled, level, values in (
        (REFLECTANCE_FACTOR, factor, isotropic, measured[REFLECTANCE_FACTOR] / scale),
        (NADIR_RATIO, ratios, xr.ones_like(isotropic), measured_ratio),
    ):
        frame = modelled.assign(isotropic=level).reset_coords(drop=True).to_dataframe()
        frame = frame.reset_index().sort_values([*models, "row"], ignore_index=True)
        index = frame["row"].to_numpy()
        rows = measured.drop(columns=REFLECTANCE_FACTOR).iloc[index].reset_index(drop=True)
        rows = rows.assign(quantity=quantity, measured=values.to_numpy()[index])
        parts.append(pd.concat([frame[models], rows, frame[list(VALUE_COLUMNS[1:])]], axis=1))
    return pd.concat(parts, ignore_index=True).dropna(subset="measured", ignore_index=True)


def _select_directions(
    dataset: xr.Dataset, measured: pd.DataFrame, parameters: list[str]
) -> tuple[xr.Dataset, xr.Dataset, xr.DataArray]:
    """Return reflectance factors in all directions and at the nadir, and the reflectance."""
    fixed = {
        name: xr.DataArray(_match_labels(dataset[name].values, measured[name]), dims="row")
        for name in parameters
    } | {"wavelength": xr.DataArray(measured.wavelength_nm.to_numpy(dtype=float), dims="row")}
    factor = np.pi * dataset[["brdf", "brdf_stderr"]]
    factor = factor.rename(brdf="modelled", brdf_stderr="stderr").sel(fixed)
    # The azimuth 360° is added for interpolation.
    last = factor.isel(azimuth_deg=[0]).assign_coords(azimuth_deg=[360.0])
    angles = {
        name: xr.DataArray(measured[name].to_numpy(dtype=float), dims="row")
        for name in ("polar_deg", "azimuth_deg")
    }
    directions = xr.concat([factor, last], "azimuth_deg").interp(angles)
    nadir = factor.isel(polar_deg=0).mean("azimuth_deg")
    return directions, nadir, dataset.reflectance.sel(fixed)


def _compute_nadir_ratio(measured: pd.DataFrame, parameters: list[str]) -> pd.Series:
    """Return the ratio to the mean of the nadir in the same scan, NaN at the nadir."""
    factor, is_nadir = measured[REFLECTANCE_FACTOR], measured.polar_deg == 0.0
    scan = measured.azimuth_deg.astype(float) % 180.0
    keys = [measured[name] for name in (*parameters, "wavelength_nm")]
    nadir = factor.where(is_nadir).groupby([*keys, scan]).transform("mean")
    if nadir.isna().any():
        raise invalid("directions.polar_deg", "a scan", "with the nadir, polar_deg 0")
    return (factor / nadir).where(~is_nadir)


def summarize_by_angle(table: pd.DataFrame) -> pd.DataFrame:
    """Return root-mean-square differences by viewing angle.

    Parameters
    ----------
    table : pandas.DataFrame
        Output of `compare_with_measured`.

    Returns
    -------
    pandas.DataFrame
        A row for each model, point of the grid, wavelength, quantity and polar angle, and for
        `ALL_DIRECTIONS`, with ``rmse``, the mean difference ``bias``, ``directions``, and
        ``isotropic_rmse``, the root-mean-square difference of an isotropic model.
    """
    keys = [c for c in table if c not in ("azimuth_deg", *VALUE_COLUMNS)]
    all_directions = table.assign(polar_deg=ALL_DIRECTIONS)
    rows = []
    for values, part in [
        pair
        for rows_of in (table, all_directions)
        for pair in rows_of.groupby(keys, sort=False, dropna=False)
    ]:
        difference = (part.modelled - part.measured).to_numpy()
        rows.append(
            dict(zip(keys, values, strict=True))
            | {
                "rmse": float(np.sqrt((difference**2).mean())),
                "bias": float(difference.mean()),
                "isotropic_rmse": float(np.sqrt(((part.isotropic - part.measured) ** 2).mean())),
                "model_stderr": float(np.sqrt((part.stderr**2).mean())),
                "directions": len(part),
            }
        )
    return pd.DataFrame(rows)


def _check_columns(dataset: xr.Dataset, measured: pd.DataFrame) -> None:
    """Reject a table with missing or unknown columns, without rows or with gaps."""
    for name in MEASURED_COLUMNS:
        if name not in measured:
            raise invalid("directions", list(measured.columns), f"a table with column {name}")
        values = pd.to_numeric(measured[name], errors="coerce").to_numpy(dtype=float)
        gaps = np.flatnonzero(~np.isfinite(values))
        if gaps.size:
            value = measured[name].iloc[int(gaps[0])]
            raise invalid(f"directions.{name}", value, "numbers without gaps")
    if not len(measured):
        raise invalid("directions", "no rows", "a table of measured directions")
    for name in measured.columns:
        if name not in MEASURED_COLUMNS and name not in dataset.brdf.dims:
            allowed = (
                f"left out, or an axis of the experiment: {', '.join(map(str, dataset.brdf.dims))}"
            )
            raise invalid("directions (column)", name, allowed)


def _check_directions(dataset: xr.Dataset, measured: pd.DataFrame) -> None:
    """Reject directions outside a dataset, and a dataset without the nadir."""
    polar, azimuth = dataset.polar_deg.values, dataset.azimuth_deg.values
    if polar[0] != 0.0 or azimuth[0] != 0.0:
        raise invalid("polar_deg", [float(polar[0]), float(azimuth[0])], "from 0 on, as azimuths")
    for name, last in (("polar_deg", polar[-1]), ("azimuth_deg", 360.0)):
        if not measured[name].between(0.0, last).all():
            raise invalid(f"directions.{name}", float(measured[name].max()), f"0 to {last:g}")
    missing = set(measured.wavelength_nm.astype(float)) - set(dataset.wavelength.values)
    if missing:
        raise invalid("directions.wavelength_nm", sorted(missing), "those of the experiment")


def _match_labels(labels: np.ndarray, values: pd.Series) -> np.ndarray:
    """Return the labels of a grid that match values."""
    label_of = {str(label): label for label in labels}
    label_of |= {f"{float(k):g}": v for k, v in label_of.items() if _is_number(k)}
    texts = [f"{v:g}" if not isinstance(v, str) else v for v in values]
    for text in texts:
        if text not in label_of:
            raise invalid(
                f"directions.{values.name}", text, f"one of {', '.join(map(str, labels))}"
            )
    return np.array([label_of[text] for text in texts])


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def draw_anisotropy(
    dataset: xr.Dataset, table: pd.DataFrame, misfits: pd.DataFrame, wavelength_nm: float
) -> Figure:
    """Draw the principal plane and all directions for every measured sample, a column each.

    Parameters
    ----------
    dataset : xarray.Dataset
        BRDF, see `compare_with_measured`.
    table, misfits : pandas.DataFrame
        Outputs of `compare_with_measured` and `summarize_by_angle`.
    wavelength_nm : float
        Wavelength of the principal plane.
    """
    axis, sample = MODEL_AXIS, SAMPLE_AXIS
    table, misfits = (one[one.quantity == NADIR_RATIO] for one in (table, misfits))
    samples, models = list(dict.fromkeys(table[sample])), list(map(str, dataset[axis].values))
    colours = dict(zip(models, pick_colours(len(models), "medium"), strict=True))
    with use_style():
        figure, panels = make_subplots(
            2,
            len(samples),
            width=TWO_COLUMNS_INCHES,
            height=_HEIGHT_INCHES,
            sharey="row",
            squeeze=False,
            gridspec_kw={"height_ratios": [1.0, 1.1]},
        )
        for column, value in enumerate(samples):
            top, bottom = panels[:, column]
            rows = table[table[sample] == value]
            label = next(x for x in dataset[sample].values if float(x) == float(value))
            _draw_plane(
                top,
                dataset.sel({sample: label}),
                rows[rows.wavelength_nm == wavelength_nm],
                axis,
                colours,
            )
            top.set_title(f"{format_parameter(sample)} {value:g}, {wavelength_nm:g} nm")
            _draw_all_directions(bottom, rows, misfits[misfits[sample] == value], axis, colours)
        panels[0, 0].set_ylabel("ratio to the nadir")
        panels[1, 0].set_ylabel("ratio to the nadir, modelled")
        note = (
            "Above: principal plane, forward to the right; bands are two standard errors of the "
            "model. Below: every direction and wavelength; markers show the viewing angle."
        )
        return annotate_figure(figure, panels[0], note)


def _draw_plane(
    axes: Axes, dataset: xr.Dataset, rows: pd.DataFrame, model_axis: str, colour_of: dict[str, Any]
) -> None:
    """Draw the principal plane of every model and of the measurement."""
    for model, colour in colour_of.items():
        part = dataset.sel({model_axis: model}).sel(wavelength=float(rows.wavelength_nm.iloc[0]))
        plane = select_principal_plane(part[["brdf", "brdf_stderr"]])
        plane = plane.isel(angle=np.abs(plane.angle.values) <= MAX_PLANE_ANGLE_DEG)
        nadir = float(plane.brdf.sel(angle=0.0, method="nearest"))
        x, y = plane.angle.values, plane.brdf.values / nadir
        error = BAND_SIGMA * plane.brdf_stderr.values / nadir
        axes.plot(x, y, color=colour, lw=1.2, label=format_value(model, model_axis))
        axes.fill_between(x, y - error, y + error, color=colour, alpha=0.25, lw=0)
    first = rows[rows[model_axis] == next(iter(colour_of))]
    inside = first[first.azimuth_deg.isin([0.0, 180.0])]
    x = np.where(inside.azimuth_deg == 0.0, 1.0, -1.0) * inside.polar_deg
    axes.plot(x, inside.measured, "o", color="black", ms=4, label="measured", zorder=3)
    axes.set_xlabel("viewing angle, forward positive (°)")
    axes.legend(frameon=False, fontsize=SMALL_FONT_PT)


def _draw_all_directions(
    axes: Axes,
    rows: pd.DataFrame,
    misfits: pd.DataFrame,
    model_axis: str,
    colour_of: dict[str, Any],
) -> None:
    """Draw every direction and wavelength of a sample, modelled over measured."""
    angles = sorted(rows.polar_deg.unique())
    for model, colour in colour_of.items():
        summary = misfits[(misfits[model_axis] == model) & (misfits.polar_deg == ALL_DIRECTIONS)]
        rmse = float(np.sqrt(np.average(summary.rmse**2, weights=summary.directions)))
        for marker, angle in zip(ANGLE_MARKERS, angles, strict=False):
            part = rows[(rows[model_axis] == model) & (rows.polar_deg == angle)]
            label = (
                f"{format_value(model, model_axis)}: RMSE {rmse:.3f}"
                if marker == ANGLE_MARKERS[0]
                else None
            )
            axes.plot(part.measured, part.modelled, marker, color=colour, ms=2.2, alpha=0.6,
                      label=label)  # fmt: skip
    low, high = min(rows.measured.min(), rows.modelled.min()), max(rows.measured.max(),
                                                                rows.modelled.max())  # fmt: skip
    axes.plot([low, high], [low, high], color="black", lw=0.6)
    for marker, angle in zip(ANGLE_MARKERS, angles, strict=False):
        axes.plot([], [], marker, color="0.4", ms=2.5, label=f"seen from {angle:g}°")
    axes.set_xlabel("ratio to the nadir, measured")
    axes.legend(frameon=False, fontsize=SMALL_FONT_PT, loc="upper left")
