"""Modelled beside measured directions: anisotropy factors, and how far they are apart by angle.

How what was found goes with what is known: a line through the origin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.validation import invalid

FACTOR_COLUMN = "anisotropy_factor"
MEASURED_COLUMNS = ("wavelength_nm", "polar_deg", "azimuth_deg", FACTOR_COLUMN)
"""What a table of measured directions has, besides columns named like parameters of a grid."""
ALL_DIRECTIONS = "all"
"""In place of an angle: every direction."""


def compare_with_measured(dataset: xr.Dataset, measured: pd.DataFrame) -> pd.DataFrame:
    """Return every measured anisotropy factor with the modelled one, for each model.

    The anisotropy factor is reflectance seen from a direction over that seen from above, so the
    level of light does not count.

    Parameters
    ----------
    dataset : xarray.Dataset
        BRDF over ``polar`` and ``azimuth`` (degrees), ``wavelength`` (nm) and a grid.  Axes of it
        that the table has no column for are models.
    measured : pandas.DataFrame
        With `MEASURED_COLUMNS` and one column for each other axis, whose values the grid has.

    Returns
    -------
    pandas.DataFrame
        The table's columns, one for each model's axis, ``modelled`` and ``stderr``.

    Raises
    ------
    ValueError
        For a column that is missing, or directions that the dataset does not have.
    """
    if "brdf" not in dataset:
        raise invalid("dataset", dataset.attrs.get("title", "a dataset"), "with a BRDF")
    _check_columns(dataset, measured)
    brdf, error = dataset.brdf, dataset.brdf_stderr
    parameters = [c for c in measured.columns if c not in MEASURED_COLUMNS]
    models = [str(d) for d in brdf.dims if d not in ("wavelength", "polar", "azimuth", *parameters)]
    _check_directions(dataset, measured)
    # Once around: directions lie between those of the dataset.
    around = [xr.concat([v, v.isel(azimuth=[0]).assign_coords(azimuth=[360.0])], "azimuth")
              for v in (brdf, error)]  # fmt: skip
    place = {
        name: xr.DataArray(measured[column].to_numpy(dtype=float), dims="row")
        for name, column in (("polar", "polar_deg"), ("azimuth", "azimuth_deg"))
    }
    fixed = {
        name: xr.DataArray(_match_labels(dataset[name].values, measured[name]), dims="row")
        for name in parameters
    } | {"wavelength": xr.DataArray(measured.wavelength_nm.to_numpy(dtype=float), dims="row")}
    seen = [one.sel(fixed).interp(place) for one in around]
    above = [one.sel(fixed).isel(polar=0).mean("azimuth") for one in around]
    factor = seen[0] / above[0]
    stderr = factor * np.hypot(seen[1] / seen[0], above[1] / above[0])
    found = factor.to_dataset(name="modelled").assign(stderr=stderr).reset_coords(drop=True)
    frame = found.to_dataframe().reset_index().sort_values([*models, "row"], ignore_index=True)
    rows = measured.iloc[frame["row"].to_numpy()].reset_index(drop=True)
    return pd.concat([frame[models], rows, frame[["modelled", "stderr"]]], axis=1)


def summarize_by_angle(table: pd.DataFrame) -> pd.DataFrame:
    """Return root-mean-square differences of anisotropy factors by the angle of view.

    Parameters
    ----------
    table : pandas.DataFrame
        As `compare_with_measured` returns it.

    Returns
    -------
    pandas.DataFrame
        A row for each model, point of the grid, wavelength and polar angle, and for
        `ALL_DIRECTIONS` one, with ``rmse``, the mean difference ``bias``, ``directions``, and
        ``spread``: the root mean square of what was measured less 1, which a model without
        directions would miss.
    """
    keys = [c for c in table if c not in ("azimuth_deg", FACTOR_COLUMN, "modelled", "stderr")]
    whole = table.assign(polar_deg=ALL_DIRECTIONS)
    rows = []
    for values, part in [
        pair for one in (table, whole) for pair in one.groupby(keys, sort=False, dropna=False)
    ]:
        off = (part.modelled - part[FACTOR_COLUMN]).to_numpy()
        rows.append(
            dict(zip(keys, values, strict=True))
            | {
                "rmse": float(np.sqrt((off**2).mean())),
                "bias": float(off.mean()),
                "spread": float(np.sqrt(((part[FACTOR_COLUMN] - 1.0) ** 2).mean())),
                "model_stderr": float(np.sqrt((part.stderr**2).mean())),
                "directions": len(part),
            }
        )
    return pd.DataFrame(rows)


def _check_columns(dataset: xr.Dataset, measured: pd.DataFrame) -> None:
    """Reject a table without the columns it must have, with others, empty or with gaps."""
    for name in MEASURED_COLUMNS:
        if name not in measured:
            raise invalid("directions", list(measured.columns), f"a table with column {name}")
        values = pd.to_numeric(measured[name], errors="coerce").to_numpy(dtype=float)
        wrong = np.flatnonzero(~np.isfinite(values))
        if wrong.size:
            given = measured[name].iloc[int(wrong[0])]
            raise invalid(f"directions.{name}", given, "numbers without gaps")
    if not len(measured):
        raise invalid("directions", "no rows", "a table of measured directions")
    for name in measured.columns:
        if name not in MEASURED_COLUMNS and name not in dataset.brdf.dims:
            allowed = (
                f"left out, or an axis of the experiment: {', '.join(map(str, dataset.brdf.dims))}"
            )
            raise invalid("directions (column)", name, allowed)


def _check_directions(dataset: xr.Dataset, measured: pd.DataFrame) -> None:
    """Reject directions beyond those of a dataset, and one that does not look from above."""
    polar, azimuth = dataset.polar.values, dataset.azimuth.values
    if polar[0] != 0.0 or azimuth[0] != 0.0:
        raise invalid("polar_deg", [float(polar[0]), float(azimuth[0])], "from 0 on, azimuths too")
    for name, last in (("polar_deg", polar[-1]), ("azimuth_deg", 360.0)):
        if not measured[name].between(0.0, last).all():
            raise invalid(f"directions.{name}", float(measured[name].max()), f"0 to {last:g}")
    missing = set(measured.wavelength_nm.astype(float)) - set(dataset.wavelength.values)
    if missing:
        raise invalid("directions.wavelength_nm", sorted(missing), "those of the experiment")


def _match_labels(labels: np.ndarray, values: pd.Series) -> np.ndarray:
    """Return the labels of a grid that values have."""
    known = {str(label): label for label in labels}
    known |= {f"{float(k):g}": v for k, v in known.items() if _is_number(k)}
    texts = [f"{v:g}" if not isinstance(v, str) else v for v in values]
    for text in texts:
        if text not in known:
            raise invalid(
                f"directions.{values.name}", text, f"one of {', '.join(map(str, labels))}"
            )
    return np.array([known[text] for text in texts])


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


class ProportionalFit(NamedTuple):
    """A line y = a x through points that count alike.

    Attributes
    ----------
    slope, stderr : float
        a, and its standard error by the scatter.
    scatter : float
        Standard deviation of y about the line.
    """

    slope: float
    stderr: float
    scatter: float


def fit_proportional(x: np.ndarray, y: np.ndarray) -> ProportionalFit:
    """Return the line through the origin that comes nearest to points.

    Parameters
    ----------
    x, y : float, shape (points,)
        Two points or more.
    """
    square = float((x * x).sum())
    slope = float((x * y).sum() / square)
    scatter = float(np.sqrt(np.sum((y - slope * x) ** 2) / (len(x) - 1)))
    return ProportionalFit(slope, scatter / float(np.sqrt(square)), scatter)
