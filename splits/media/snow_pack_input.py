"""Input of `splits.SnowPacks`: variables of a dataset or a long table as arrays, with checks."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.arrays import (
    align_to_labels,
    as_1d_array,
    as_float_array,
    check_increasing,
    find_labels,
    match_labels,
)
from splits.core.labels import (
    check_direction,
    check_nanometres,
    convert_units,
    normalize_attributes,
    normalize_labels,
)
from splits.core.validation import (
    as_scalar,
    check_relations,
    invalid,
    join_names,
    suggest_name,
    unknown_key,
)
from splits.materials.impurities import list_impurities
from splits.media.ground import (
    BLACK,
    OPEN,
    TABLE_NAME,
    WAVELENGTH_DIM,
    Ground,
    is_ground_spectrum,
)
from splits.media.parameters import describe_parameter
from splits.media.snow import OPTICAL_RADIUS_KEY, SURFACE_AREA_KEY

# --------------------------------------------------------------------------------------------------
# Ground below the snowpacks of `splits.SnowPacks`: one for all, or an albedo for each.
#
# A ground for all is in the attributes of the dataset of snowpacks, and its name is the variable
# ``ground`` over the label.  An albedo for each is the variable ``ground_albedo`` over the label,
# or over the label and ``wavelength``.

GROUND_KEY = "ground_albedo"
GROUND_ATTRIBUTE = "ground"
_TABLE_ATTRIBUTES = ("ground_wavelength_nm", "ground_values")
PackGround = Ground | xr.DataArray | None
"""Ground of all snowpacks, an albedo for each with NaN where it is missing, or none."""


def read_ground(value: Any, label: str, labels: pd.Index) -> PackGround:
    """Return the ground for a user's value, see `splits.SnowPacks`.

    Parameters
    ----------
    value : object
    label : str
        Dimension of the snowpacks.
    labels : pandas.Index
        Labels of the snowpacks.
    """
    is_array = isinstance(value, xr.DataArray) and bool(value.ndim)
    is_row = isinstance(value, np.ndarray | pd.Series | Sequence) and not isinstance(value, str)
    if is_ground_spectrum(value) or not (is_array or (is_row and np.ndim(value))):
        return Ground.from_input(value)
    if not is_array:
        albedo = align_to_labels(GROUND_KEY, value, labels.tolist(), allow_gaps=True)
        if albedo.shape != (labels.size,):
            given = f"numbers of shape {albedo.shape}"
            raise invalid(GROUND_KEY, given, f"one ground, or {labels.size} albedos")
        return xr.DataArray(albedo, dims=label)
    has_wavelengths = WAVELENGTH_DIM in value.dims
    check_relations(
        (
            {label} <= set(value.dims) <= {label, WAVELENGTH_DIM},
            f"{GROUND_KEY} dimensions", value.dims,
            f"{label}, or {label} and {WAVELENGTH_DIM}, with coordinates",
        ),
        (
            not has_wavelengths
            or (WAVELENGTH_DIM in value.coords and value.sizes[WAVELENGTH_DIM] >= 2),
            f"{GROUND_KEY}.{WAVELENGTH_DIM}", "left out or short",
            "a coordinate (nm) of at least 2 wavelengths",
        ),
    )  # fmt: skip
    coordinates = {}
    if has_wavelengths:
        check_nanometres(GROUND_KEY, value[WAVELENGTH_DIM])
        value = value.sortby(WAVELENGTH_DIM)
        wavelength_nm = as_1d_array(WAVELENGTH_DIM, value[WAVELENGTH_DIM], "numbers (nm)")
        check_increasing(f"{GROUND_KEY}.{WAVELENGTH_DIM}", wavelength_nm)
        coordinates = {WAVELENGTH_DIM: wavelength_nm}
    value = value.transpose(label, ...)
    value = value[match_labels(GROUND_KEY, find_labels(value), [labels.tolist()])]
    if value.sizes[label] != labels.size:
        raise invalid(GROUND_KEY, f"{value.sizes[label]} albedos", f"{labels.size} of them")
    numbers = as_float_array(GROUND_KEY, value, allow_gaps=True)
    numbers[~np.isfinite(numbers)] = np.nan
    return xr.DataArray(numbers, coordinates, value.dims)


def read_stored_ground(data: xr.Dataset, label: str) -> PackGround:
    """Return the ground in a dataset of snowpacks; its names differ after a concatenation."""
    index = data.get_index(label)
    albedo: Any = None
    if GROUND_KEY in data:
        variable = data[GROUND_KEY].drop_vars(
            [name for name in data[GROUND_KEY].coords if name not in (label, WAVELENGTH_DIM)]
        )
        if not variable.ndim:
            variable = variable.expand_dims({label: index})
        albedo = read_ground(variable, label, index)
    if GROUND_ATTRIBUTE not in data:
        return _read_ground_attributes(data.attrs) if albedo is None else albedo
    names = data[GROUND_ATTRIBUTE]
    if names.dims != (label,):
        raise invalid(f"{GROUND_ATTRIBUTE} dimensions", names.dims, f"over {label}")
    is_named = ~pd.isna(names.values)
    distinct = [*dict.fromkeys(str(name) for name in names.values[is_named])]
    if is_named.all() and len(distinct) == 1:
        common = _read_ground_attributes(data.attrs)
        is_same = name_ground(common) == distinct[0]
        return common if is_same else Ground.from_input(_parse_name(distinct[0]))
    numbers = {BLACK: 0.0, **{name: _parse_name(name) for name in distinct if name != BLACK}}
    if any(isinstance(numbers[name], str) for name in distinct):
        allowed = "the same below all snowpacks, or albedos"
        hint = "SnowPacks(data, ground=…) gives one for all, or an albedo for each"
        raise invalid(GROUND_ATTRIBUTE, distinct, allowed, hint)
    named = xr.DataArray([numbers.get(str(name), np.nan) for name in names.values], dims=label)
    # Where a name is missing, there is an albedo.
    return named if albedo is None else named.fillna(albedo).transpose(*albedo.dims)


def _read_ground_attributes(attributes: Mapping[str, Any]) -> Ground | None:
    """Return the ground of all snowpacks in attributes, see `store_ground`."""
    name, table = attributes.get(GROUND_ATTRIBUTE), [attributes.get(n) for n in _TABLE_ATTRIBUTES]
    if name is None or table[0] is None:
        return Ground.from_input(name)
    ground = Ground.from_input({"wavelength_nm": table[0], "albedo": table[1]})
    assert ground is not None
    return replace(ground, name=name, sha256=attributes.get("ground_sha256", ""))


def name_ground(ground: Ground | None) -> str:
    """Return the text that identifies a ground of all snowpacks among those of others."""
    if ground is None:
        return OPEN
    name = str(store_ground(ground)[GROUND_ATTRIBUTE])
    if not is_ground_table(ground) or ground.wavelength_nm is None:
        return name
    content = np.concatenate([ground.wavelength_nm, ground.albedo_values])
    return f"{name} {hashlib.sha256(content.tobytes()).hexdigest()[:12]}"


def is_ground_table(ground: Ground) -> bool:
    """Return whether a ground is a table of the user."""
    return bool(ground.sha256) or ground.name == TABLE_NAME


def store_ground(ground: Ground | None) -> dict[str, Any]:
    """Return a ground of all snowpacks as attributes of a dataset."""
    if ground is None or not is_ground_table(ground):
        return {GROUND_ATTRIBUTE: OPEN if ground is None else ground.as_input()}
    columns = (ground.wavelength_nm, ground.albedo_values)
    attributes = dict(zip(_TABLE_ATTRIBUTES, columns, strict=True))
    digest = {"ground_sha256": ground.sha256} if ground.sha256 else {}
    return {GROUND_ATTRIBUTE: ground.name, **attributes, **digest}


def _parse_name(name: str) -> float | str:
    """Return the albedo of a name that is a number; other names unchanged."""
    with suppress(ValueError):
        return float(name)
    return name


# --------------------------------------------------------------------------------------------------
# Input of `splits.SnowPacks`: variables of a dataset or a long table as arrays, with checks.

LAYER_DIM = "layer"
DEFAULT_LABEL = "time"
THICKNESS_KEY, DENSITY_KEY, DEPTH_KEY = "thickness_m", "density_kg_m3", "depth_top_m"
TEMPERATURE_KEY, WATER_KEY, ZENITH_KEY = "temperature_c", "liquid_water_content", "sun_zenith_deg"
LAYER_HINT = "it counts the layers of each snowpack, 0 at the top"
"""What the column of layers contains."""
DEFAULTS = {TEMPERATURE_KEY: -1.0, WATER_KEY: 0.0}
"""Values of optional variables that are not given."""
IMPURITIES_KEY = "impurities_ng_g"
DESCRIPTIONS = {
    THICKNESS_KEY: ("thickness of the layer", "m"),
    DEPTH_KEY: ("depth of the top of the layer below the surface", "m"),
    ZENITH_KEY: ("zenith angle of the sun", "degree"),
    GROUND_KEY: ("albedo of the ground", "1"),
}
"""Long names and units of variables that are no parameters of a medium."""
FLAG_NAME, LAYER_FLAG_NAME = "quality_flag", "layer_flag"
KNOWN_NAMES = (
    THICKNESS_KEY, DENSITY_KEY, SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY, *DEFAULTS, DEPTH_KEY,
    ZENITH_KEY, GROUND_KEY,
)  # fmt: skip


def describe_variable(name: str) -> tuple[str, str]:
    """Return the long name and units of a variable of snowpacks."""
    return DESCRIPTIONS.get(name) or describe_parameter(name)


def read_input(data: Any, label: str | None, ground: Any) -> tuple[xr.Dataset, PackGround]:
    """Return the variables of snowpacks in their units, and the ground.

    See `splits.SnowPacks` for the arguments and errors.

    Returns
    -------
    dataset : xarray.Dataset
        Variables over the label and ``layer``, or over one of both if they are the same along the
        other; NaN for missing and for infinite numbers.  The layers have no coordinate.
    ground : Ground, xarray.DataArray or None
    """
    if isinstance(data, pd.DataFrame):
        data = _pivot_frame(data, label)
    if not isinstance(data, xr.Dataset):
        allowed = "an xarray.Dataset or a pandas.DataFrame"
        hint = f"splits.read_snow_packs({str(data)!r}) reads files"
        is_path = isinstance(data, str | os.PathLike)
        raise invalid("data", data if is_path else type(data).__name__, allowed, is_path * hint)
    for name in {*data.dims, *data.indexes} - {LAYER_DIM, WAVELENGTH_DIM}:
        _check_label_name(name)
    data = data.drop_vars([FLAG_NAME, LAYER_FLAG_NAME], errors="ignore")
    own_names = (*KNOWN_NAMES, GROUND_ATTRIBUTE)
    data = data.reset_coords([name for name in own_names if name in data.coords])
    check_names(name for name in data.data_vars if name != GROUND_ATTRIBUTE)
    sizes = dict(data[THICKNESS_KEY].sizes)
    others = [dim for dim in sizes if dim != LAYER_DIM]
    has_two = LAYER_DIM in sizes and len(others) == 1 and label in (None, *others)
    check_relations(
        (
            has_two, f"{THICKNESS_KEY} dimensions", tuple(map(str, sizes)),
            f"over {label or 'time, or another label,'} and {LAYER_DIM}",
            "stack other dimensions: dataset.stack(snowpack=('time', 'point'))",
        ),
        *((size, str(name), "no values", "at least one") for name, size in sizes.items()),
    )  # fmt: skip
    label = str(others[0])
    _check_label_name(label)
    data = _normalize_coordinates(data, label)
    index = data.get_index(label)
    pack_ground = read_stored_ground(data, label) if ground is None else read_ground(
        ground, label, index
    )  # fmt: skip
    data = data.drop_vars([GROUND_KEY, GROUND_ATTRIBUTE, WAVELENGTH_DIM], errors="ignore")
    if LAYER_DIM in data.coords:
        number = as_float_array(LAYER_DIM, data[LAYER_DIM], "numbers, 0 at the top")
        check_increasing(LAYER_DIM, np.sort(number))
        data = data.sortby(LAYER_DIM)
        check_direction(data[LAYER_DIM], "down")
    variables = {}
    for name, variable in data.data_vars.items():
        key, expected = str(name), (label,) if name == ZENITH_KEY else (label, LAYER_DIM)
        if not set(variable.dims) <= set(expected):
            raise invalid(f"{key} dimensions", variable.dims, f"among {', '.join(expected)}")
        numbers = as_float_array(key, variable, allow_gaps=True)
        numbers[~np.isfinite(numbers)] = np.nan
        unit = variable.attrs.get("units")
        numbers = convert_units(key, numbers, unit, describe_variable(key)[1])
        variables[name] = variable.variable.copy(data=numbers)
    if DEPTH_KEY in variables:
        # The depths of each snowpack increase; absent layers may have none.
        full_sizes = {dim: data.sizes[dim] for dim in (label, LAYER_DIM)}
        depths_m = variables.pop(DEPTH_KEY).set_dims(full_sizes).values
        deepest = np.fmax.accumulate(depths_m, axis=1)
        rows, layers = np.nonzero(depths_m[:, 1:] <= deepest[:, :-1])
        if rows.size:
            row, layer = rows[0], layers[0]
            pair = [float(deepest[row, layer]), float(depths_m[row, layer + 1])]
            place = f"layer {layer + 1} of the snowpack at {index[row]}"
            allowed = "strictly increasing from the surface down"
            raise invalid(DEPTH_KEY, pair, allowed, f"{place}; {LAYER_DIM} 0 is at the top")
    elsewhere = [name for name, one in data.coords.items() if not set(one.dims) <= {label}]
    coordinates = data.drop_vars([*data.data_vars, *elsewhere])
    return coordinates.assign(variables), pack_ground


def _check_label_name(label: Any) -> None:
    """Check that a label is a text, and no name of another dimension or of a variable."""
    others = (LAYER_DIM, WAVELENGTH_DIM, FLAG_NAME, LAYER_FLAG_NAME, GROUND_ATTRIBUTE)
    text = str(label)
    is_known = text in (*KNOWN_NAMES, *others) or text.startswith(f"{IMPURITIES_KEY}.")
    check_relations(
        (isinstance(label, str), "label", label, "a text, the name of a dimension or column"),
        (
            not is_known, "label", label, "a name that no variable of snowpacks has",
            f"rename it: data.rename({{{label!r}: 'time'}})",
        ),
    )  # fmt: skip


def _normalize_coordinates(data: xr.Dataset, label: str) -> xr.Dataset:
    """Return a dataset whose labels, and other coordinates of snowpacks, files can hold."""
    index = data.get_index(label)
    labels = normalize_labels(label, index)
    is_gap, repeated = labels.to_frame().isna().to_numpy(), labels[labels.duplicated()]
    check_relations(
        (
            not is_gap.any(), label, "a gap", "a label for each snowpack",
            "masked, NaN or missing",
        ),
        (
            not repeated.size, label, str(next(iter(repeated), "")), "different for each snowpack",
            f"{repeated.size} of {labels.size} labels repeat an earlier one",
        ),
    )  # fmt: skip
    if isinstance(labels, pd.MultiIndex):
        return data.assign_coords(xr.Coordinates.from_pandas_multiindex(labels, label))
    for name in map(str, data.coords):
        coordinate, attrs = data[name], normalize_attributes(data[name].attrs)
        if name == label:
            data = data.assign_coords({name: (label, labels, attrs)})
        elif coordinate.dims in ((), (label,)):
            row = coordinate if coordinate.ndim else coordinate.expand_dims(label)
            values = normalize_labels(name, row.to_index()).to_numpy().reshape(coordinate.shape)
            data = data.assign_coords({name: (coordinate.dims, values, attrs)})
    return data


def check_names(given: Iterable[Hashable]) -> None:
    """Check that all required variables are given and that all given ones are known."""
    names = [str(name) for name in given]
    for name in names:
        if name.startswith(f"{IMPURITIES_KEY}."):
            kind, known = name.partition(".")[2], list_impurities()
            if kind not in known:
                allowed = f"one of {join_names(known)}"
                raise invalid(IMPURITIES_KEY, kind, allowed, suggest_name(kind, known))
        elif name not in KNOWN_NAMES:
            raise unknown_key(name, [*KNOWN_NAMES, f"{IMPURITIES_KEY}.black_carbon"])
    area, radius, hint = SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY, f"over snowpacks and {LAYER_DIM}"
    check_relations(
        (THICKNESS_KEY in names, THICKNESS_KEY, None, "given", f"a variable {hint}"),
        (DENSITY_KEY in names, DENSITY_KEY, None, "given", f"a variable {hint}"),
        (area in names or radius in names, area, None, f"given, or {radius}"),
        (not {area, radius} <= {*names}, radius, "given", f"left out where {area} is given"),
    )


def _pivot_frame(frame: pd.DataFrame, label: str | None) -> xr.Dataset:
    """Return the dataset of a table with one row per layer; rows that do not exist are NaN."""
    if any(name is not None for name in frame.index.names):
        frame = frame.reset_index()
    label = label or DEFAULT_LABEL
    _check_label_name(label)
    hints = {label: "label= names that of the snowpacks", LAYER_DIM: LAYER_HINT}
    columns = frame.columns
    check_relations(
        *(
            (name in columns, name, None, "a column", suggest_name(name, map(str, columns)) or hint)
            for name, hint in hints.items()
        ),
        (len(frame), "data", "no rows", "at least one"),
    )
    rows, labels = pd.factorize(frame[label])
    number = as_float_array(LAYER_DIM, frame[LAYER_DIM], "numbers, 0 at the top")
    table = pd.DataFrame({"row": rows, "number": number})
    repeated = np.flatnonzero(table.duplicated())[:1]
    places = [f"{labels[rows[one]]}, {number[one]:g}" for one in repeated]
    counts_all_rows = len(table) > len(labels) > 1 and table.number.is_unique
    check_relations(
        (
            (rows >= 0).all(), label, "a gap", "a label in each row", "masked, NaN or missing",
        ),
        (
            not places, f"{label}, {LAYER_DIM}", "".join(places), "different in each row",
            "rows repeat",
        ),
        (
            not counts_all_rows, LAYER_DIM, f"{len(table)} different numbers",
            "numbers that begin again in each snowpack, 0 at the top",
            "frame.groupby(label).cumcount() counts the layers of each snowpack",
        ),
    )  # fmt: skip
    # Only the order of numbers matters: layers between others that do not exist are absent.
    columns = table.groupby("row").number.rank().to_numpy(dtype=int) - 1
    layers = np.arange(columns.max() + 1)
    index = pd.Index(labels, tupleize_cols=False).infer_objects()
    dataset = xr.Dataset(coords={label: index, LAYER_DIM: layers})
    for column in frame.columns.drop([label, LAYER_DIM]):
        if column == GROUND_ATTRIBUTE:
            values = frame[column].to_numpy(dtype=object)
        else:
            values = as_float_array(str(column), frame[column], allow_gaps=True)
        if column in (GROUND_ATTRIBUTE, ZENITH_KEY, GROUND_KEY):
            # Each snowpack has one value, whatever the number of its layers.
            is_given = ~pd.isna(values)
            found = np.full(index.size, np.nan, dtype=values.dtype)
            found[rows[is_given]] = values[is_given]
            different = np.flatnonzero(is_given & (found[rows] != values))
            if different.size:
                row = different[0]
                pair = [as_scalar(one) for one in (values[row], found[rows[row]])]
                allowed = "the same for all layers of a snowpack"
                raise invalid(str(column), pair, allowed, f"at {index[rows[row]]}")
            dataset[column] = (label, found)
        else:
            table = np.full((index.size, layers.size), np.nan)
            table[rows, columns] = values
            dataset[str(column)] = ((label, LAYER_DIM), table)
    return dataset
