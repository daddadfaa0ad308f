"""Comparison of modelled and measured reflectance by direction, and proportional fits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.validation import invalid

REFLECTANCE_FACTOR, NADIR_RATIO = "reflectance_factor", "nadir_ratio"
"""Quantities that are compared."""
MEASURED_COLUMNS = ("wavelength_nm", "polar_deg", "azimuth_deg", REFLECTANCE_FACTOR)
"""Columns of a table of measured directions, besides those named like parameters of a grid."""
VALUE_COLUMNS = ("measured", "modelled", "stderr", "isotropic")
ALL_DIRECTIONS = "all"
"""Label of the rows over all directions, instead of an angle."""


def compare_with_measured(
    dataset: xr.Dataset, measured: pd.DataFrame, scale: float = 1.0
) -> pd.DataFrame:
    """Return measured reflectance factors and ratios to the nadir with the modelled ones.

    A ratio to the nadir is that of the values in a direction and at the nadir of the same scan, a
    plane through the nadir.  It does not depend on the scale, and is not defined at the nadir.

    Parameters
    ----------
    dataset : xarray.Dataset
        BRDF over ``polar`` and ``azimuth`` (degrees), ``wavelength`` (nm) and a grid, and
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
    fixed_dims = ("wavelength", "polar", "azimuth", *parameters)
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
    last = factor.isel(azimuth=[0]).assign_coords(azimuth=[360.0])
    angles = {
        name: xr.DataArray(measured[f"{name}_deg"].to_numpy(dtype=float), dims="row")
        for name in ("polar", "azimuth")
    }
    directions = xr.concat([factor, last], "azimuth").interp(angles)
    nadir = factor.isel(polar=0).mean("azimuth")
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
