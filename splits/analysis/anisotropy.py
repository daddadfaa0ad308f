"""Comparison of modelled and measured anisotropy factors, and proportional fits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.validation import invalid

FACTOR_COLUMN = "anisotropy_factor"
MEASURED_COLUMNS = ("wavelength_nm", "polar_deg", "azimuth_deg", FACTOR_COLUMN)
"""Columns of a table of measured directions, besides those named like parameters of a grid."""
ALL_DIRECTIONS = "all"
"""Label of the rows over all directions, instead of an angle."""


def compare_with_measured(dataset: xr.Dataset, measured: pd.DataFrame) -> pd.DataFrame:
    """Return every measured anisotropy factor with the modelled one, for each model.

    The anisotropy factor is the ratio of the BRDF in a direction to that at the nadir, so a scale
    factor cancels.

    Parameters
    ----------
    dataset : xarray.Dataset
        BRDF over ``polar`` and ``azimuth`` (degrees), ``wavelength`` (nm) and a grid.  Axes without
        a column in the table are models.
    measured : pandas.DataFrame
        With `MEASURED_COLUMNS` and one column for each other axis, with values of the grid.

    Returns
    -------
    pandas.DataFrame
        The table's columns, one for each model's axis, ``modelled`` and ``stderr``.

    Raises
    ------
    ValueError
        For a missing column, or directions outside the dataset.
    """
    if "brdf" not in dataset:
        raise invalid("dataset", dataset.attrs.get("title", "a dataset"), "with a BRDF")
    _check_columns(dataset, measured)
    brdf, error = dataset.brdf, dataset.brdf_stderr
    parameters = [c for c in measured.columns if c not in MEASURED_COLUMNS]
    models = [str(d) for d in brdf.dims if d not in ("wavelength", "polar", "azimuth", *parameters)]
    _check_directions(dataset, measured)
    # The azimuth 360° is added for interpolation.
    periodic = [xr.concat([v, v.isel(azimuth=[0]).assign_coords(azimuth=[360.0])], "azimuth")
              for v in (brdf, error)]  # fmt: skip
    angles = {
        name: xr.DataArray(measured[column].to_numpy(dtype=float), dims="row")
        for name, column in (("polar", "polar_deg"), ("azimuth", "azimuth_deg"))
    }
    fixed = {
        name: xr.DataArray(_match_labels(dataset[name].values, measured[name]), dims="row")
        for name in parameters
    } | {"wavelength": xr.DataArray(measured.wavelength_nm.to_numpy(dtype=float), dims="row")}
    viewed = [variable.sel(fixed).interp(angles) for variable in periodic]
    nadir = [variable.sel(fixed).isel(polar=0).mean("azimuth") for variable in periodic]
    factor = viewed[0] / nadir[0]
    stderr = factor * np.hypot(viewed[1] / viewed[0], nadir[1] / nadir[0])
    modelled = factor.to_dataset(name="modelled").assign(stderr=stderr).reset_coords(drop=True)
    frame = modelled.to_dataframe().reset_index().sort_values([*models, "row"], ignore_index=True)
    rows = measured.iloc[frame["row"].to_numpy()].reset_index(drop=True)
    return pd.concat([frame[models], rows, frame[["modelled", "stderr"]]], axis=1)


def summarize_by_angle(table: pd.DataFrame) -> pd.DataFrame:
    """Return root-mean-square differences of anisotropy factors by viewing angle.

    Parameters
    ----------
    table : pandas.DataFrame
        Output of `compare_with_measured`.

    Returns
    -------
    pandas.DataFrame
        A row for each model, point of the grid, wavelength and polar angle, and for
        `ALL_DIRECTIONS`, with ``rmse``, the mean difference ``bias``, ``directions``, and
        ``spread``, the root mean square of the measured factor minus 1.
    """
    keys = [c for c in table if c not in ("azimuth_deg", FACTOR_COLUMN, "modelled", "stderr")]
    all_directions = table.assign(polar_deg=ALL_DIRECTIONS)
    rows = []
    for values, part in [
        pair
        for rows_of in (table, all_directions)
        for pair in rows_of.groupby(keys, sort=False, dropna=False)
    ]:
        difference = (part.modelled - part[FACTOR_COLUMN]).to_numpy()
        rows.append(
            dict(zip(keys, values, strict=True))
            | {
                "rmse": float(np.sqrt((difference**2).mean())),
                "bias": float(difference.mean()),
                "spread": float(np.sqrt(((part[FACTOR_COLUMN] - 1.0) ** 2).mean())),
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
    polar, azimuth = dataset.polar.values, dataset.azimuth.values
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


class ProportionalFit(NamedTuple):
    """Unweighted fit of a line y = a x.

    Attributes
    ----------
    slope, stderr : float
        a, and its standard error from the scatter.
    scatter : float
        Standard deviation of y about the line.
    """

    slope: float
    stderr: float
    scatter: float


def fit_proportional(x: np.ndarray, y: np.ndarray) -> ProportionalFit:
    """Return the least-squares line through the origin.

    Parameters
    ----------
    x, y : float, shape (points,)
        At least two points.
    """
    square = float((x * x).sum())
    slope = float((x * y).sum() / square)
    scatter = float(np.sqrt(np.sum((y - slope * x) ** 2) / (len(x) - 1)))
    return ProportionalFit(slope, scatter / float(np.sqrt(square)), scatter)
