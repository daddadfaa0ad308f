"""Input of `splits.SnowPacks`: variables of a dataset or a long table as arrays, with checks."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

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
from splits.materials.refractive_index import check_wavelength_range
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


class SnowPackGround(NamedTuple):
    """Ground below snowpacks.

    Attributes
    ----------
    common : Ground or None
        Ground of all snowpacks, or an open lower boundary.
    albedo : float, shape (snowpacks,) or (snowpacks, n), or None
        Albedo for each snowpack, NaN where it is missing; instead of `common`.
    wavelength_nm : float, shape (n,), or None
        Wavelengths (nm) of the albedo, if it depends on them.
    """

    common: Ground | None = None
    albedo: np.ndarray | None = None
    wavelength_nm: np.ndarray | None = None

    @classmethod
    def from_input(cls, value: Any, label: str, labels: pd.Index) -> SnowPackGround:
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
            return cls(Ground.from_input(value))
        if not is_array:
            albedo = align_to_labels(GROUND_KEY, value, labels.tolist(), allow_gaps=True)
            if albedo.shape != (labels.size,):
                given = f"numbers of shape {albedo.shape}"
                raise invalid(GROUND_KEY, given, f"one ground, or {labels.size} albedos")
            return cls(albedo=albedo)
        if not {label} <= set(value.dims) <= {label, WAVELENGTH_DIM}:
            allowed = f"{label}, or {label} and {WAVELENGTH_DIM}, with coordinates"
            raise invalid(f"{GROUND_KEY} dimensions", value.dims, allowed)
        wavelength_nm = None
        if WAVELENGTH_DIM in value.dims:
            if WAVELENGTH_DIM not in value.coords or value.sizes[WAVELENGTH_DIM] < 2:
                allowed = "a coordinate (nm) of at least 2 wavelengths"
                raise invalid(f"{GROUND_KEY}.{WAVELENGTH_DIM}", "left out or short", allowed)
            check_nanometres(GROUND_KEY, value[WAVELENGTH_DIM])
            value = value.sortby(WAVELENGTH_DIM)
            wavelength_nm = as_1d_array(WAVELENGTH_DIM, value[WAVELENGTH_DIM], "numbers (nm)")
            check_increasing(f"{GROUND_KEY}.{WAVELENGTH_DIM}", wavelength_nm)
        value = value.transpose(label, ...)
        value = value[match_labels(GROUND_KEY, find_labels(value), [labels.tolist()])]
        if value.sizes[label] != labels.size:
            raise invalid(GROUND_KEY, f"{value.sizes[label]} albedos", f"{labels.size} of them")
        numbers = as_float_array(GROUND_KEY, value, allow_gaps=True)
        numbers[~np.isfinite(numbers)] = np.nan
        return cls(None, numbers, wavelength_nm)

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, Any]) -> SnowPackGround:
        """Return the common ground in attributes, see `make_attributes`."""
        if GROUND_ATTRIBUTE not in attributes:
            return cls()
        name, table = attributes[GROUND_ATTRIBUTE], [attributes.get(n) for n in _TABLE_ATTRIBUTES]
        if table[0] is None:
            return cls(Ground.from_input(name))
        columns = {"wavelength_nm": table[0], "albedo": table[1]}
        ground = Ground.from_input(columns)
        assert ground is not None
        digest = attributes.get("ground_sha256", "")
        return cls(Ground(name, ground.source, ground.albedo_values, ground.wavelength_nm, digest))

    @classmethod
    def from_names(
        cls, names: np.ndarray, attributes: Mapping[str, Any], albedo: SnowPackGround | None
    ) -> SnowPackGround:
        """Return the ground of snowpacks by its names, which differ after a concatenation.

        Parameters
        ----------
        names : str or missing, shape (snowpacks,)
            See `get_name`.
        attributes : mapping
            Those of `make_attributes` of one of the grounds.
        albedo : SnowPackGround or None
            Albedo for each snowpack, used where a name is missing.
        """
        is_named = ~pd.isna(names)
        distinct = [*dict.fromkeys(str(name) for name in names[is_named])]
        if is_named.all() and len(distinct) == 1:
            common = cls.from_attributes(attributes)
            is_same = common.get_name() == distinct[0]
            return common if is_same else cls(Ground.from_input(_parse_name(distinct[0])))
        numbers = {BLACK: 0.0, **{name: _parse_name(name) for name in distinct if name != BLACK}}
        texts = [name for name in distinct if isinstance(numbers[name], str)]
        if texts:
            allowed = "the same below all snowpacks, or albedos"
            hint = "SnowPacks(data, ground=…) gives one for all, or an albedo for each"
            raise invalid(GROUND_ATTRIBUTE, distinct, allowed, hint)
        named = np.array([numbers.get(str(name), np.nan) for name in names])
        if albedo is None or albedo.albedo is None:
            return cls(albedo=named)
        own = albedo.albedo
        columns = named.reshape(-1, *[1] * (own.ndim - 1))
        return albedo._replace(albedo=np.where(np.isnan(columns), own, columns))

    def get_name(self) -> str:
        """Return the text that identifies the common ground among those of other snowpacks."""
        if self.common is None:
            return OPEN
        name = str(self.make_attributes()[GROUND_ATTRIBUTE])
        if not self.is_table or self.common.wavelength_nm is None:
            return name
        content = np.concatenate([self.common.wavelength_nm, self.common.albedo_values])
        return f"{name} {hashlib.sha256(content.tobytes()).hexdigest()[:12]}"

    @property
    def is_table(self) -> bool:
        """Whether the common ground is a table of the user."""
        ground = self.common
        return ground is not None and (bool(ground.sha256) or ground.name == TABLE_NAME)

    def make_attributes(self) -> dict[str, Any]:
        """Return the common ground as attributes of a dataset."""
        if self.albedo is not None:
            return {}
        if self.common is None:
            return {GROUND_ATTRIBUTE: OPEN}
        if not self.is_table:
            return {GROUND_ATTRIBUTE: self.common.as_input()}
        columns = (self.common.wavelength_nm, self.common.albedo_values)
        attributes = dict(zip(_TABLE_ATTRIBUTES, columns, strict=True))
        digest = {"ground_sha256": self.common.sha256} if self.common.sha256 else {}
        return {GROUND_ATTRIBUTE: self.common.name, **attributes, **digest}

    def describe(self) -> str:
        """Return the ground in a few words."""
        if self.albedo is not None:
            return "an albedo for each snowpack"
        return OPEN if self.common is None else self.common.name

    def get_ground(self, position: int) -> Ground | None:
        """Return the ground of one snowpack."""
        if self.albedo is None:
            return self.common
        if self.wavelength_nm is None:
            return Ground.from_input(float(self.albedo[position]))
        columns = {"wavelength_nm": self.wavelength_nm, "albedo": self.albedo[position]}
        return Ground.from_input(columns)

    def compute_albedo(self, wavelength_nm: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Return the albedo below snowpacks at positions, shape (positions, wavelengths).

        It is linear between its wavelengths, and 0 for an open lower boundary.
        """
        shape = (positions.size, wavelength_nm.size)
        if self.albedo is None:
            ground = self.common if self.common and self.common.is_reflecting else None
            return np.broadcast_to(ground.albedo(wavelength_nm) if ground else 0.0, shape)
        if self.wavelength_nm is None:
            return np.broadcast_to(self.albedo[positions, np.newaxis], shape)
        first, last = self.wavelength_nm[[0, -1]]
        inside = check_wavelength_range(wavelength_nm, first, last, "the ground of the snowpacks")
        rows = [np.interp(inside, self.wavelength_nm, self.albedo[row]) for row in positions]
        return np.reshape(rows, shape)


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


class SnowPackInput(NamedTuple):
    """Variables of snowpacks as arrays.

    Attributes
    ----------
    label : str
        Dimension of the snowpacks.
    coordinates : xarray.Dataset
        Coordinates along this dimension, without variables.
    values : dict of float, shape (snowpacks, layers)
        Variables of layers by name, in their units; NaN for missing and for infinite numbers.
    layered : set of str
        Names of the variables that were given for each layer, not for a snowpack as a whole.
    sun_zenith_deg : float, shape (snowpacks,), or None
    ground : SnowPackGround
    """

    label: str
    coordinates: xr.Dataset
    values: dict[str, np.ndarray]
    layered: set[str]
    sun_zenith_deg: np.ndarray | None
    ground: SnowPackGround


def describe_variable(name: str) -> tuple[str, str]:
    """Return the long name and units of a variable of snowpacks."""
    return DESCRIPTIONS.get(name) or describe_parameter(name)


def read_input(data: Any, label: str | None, ground: Any) -> SnowPackInput:
    """Return the variables of snowpacks; see `splits.SnowPacks` for the arguments and errors."""
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
    dims = [str(dim) for dim in data[THICKNESS_KEY].dims]
    others = [dim for dim in dims if dim != LAYER_DIM]
    if LAYER_DIM not in dims or len(others) != 1 or label not in (None, *others):
        hint = "stack other dimensions: dataset.stack(snowpack=('time', 'point'))"
        allowed = f"over {label or 'time, or another label,'} and {LAYER_DIM}"
        raise invalid(f"{THICKNESS_KEY} dimensions", tuple(dims), allowed, hint)
    sizes = data[THICKNESS_KEY].sizes.items()
    check_relations(*((size, str(name), "no values", "at least one") for name, size in sizes))
    label = others[0]
    _check_label_name(label)
    data = _normalize_coordinates(data, label)
    pack_ground, data = _read_ground(data, label, ground)
    if LAYER_DIM in data.coords:
        number = as_float_array(LAYER_DIM, data[LAYER_DIM], "numbers, 0 at the top")
        check_increasing(LAYER_DIM, np.sort(number))
        data = data.sortby(LAYER_DIM)
        check_direction(data[LAYER_DIM], "down")
    layered: set[str] = set()
    values = {}
    for name in map(str, data.data_vars):
        variable = data[name]
        expected = (label,) if name == ZENITH_KEY else (label, LAYER_DIM)
        if not set(variable.dims) <= set(expected):
            raise invalid(f"{name} dimensions", variable.dims, f"among {', '.join(expected)}")
        if LAYER_DIM in variable.dims:
            layered.add(name)
        numbers = as_float_array(name, variable, allow_gaps=True)
        numbers[~np.isfinite(numbers)] = np.nan
        unit = variable.attrs.get("units")
        numbers = convert_units(name, numbers, unit, describe_variable(name)[1])
        sizes = {dim: data.sizes[dim] for dim in expected}
        full = xr.Variable(variable.dims, numbers).set_dims(sizes).transpose(*expected)
        values[name] = np.array(full.values)
    zenith = values.pop(ZENITH_KEY, None)
    depths_m = values.pop(DEPTH_KEY, np.empty((0, 1)))
    # The depths of each snowpack increase; absent layers may have none.
    deepest = np.fmax.accumulate(depths_m, axis=1)
    rows, layers = np.nonzero(depths_m[:, 1:] <= deepest[:, :-1])
    if rows.size:
        row, layer = rows[0], layers[0]
        pair = [float(deepest[row, layer]), float(depths_m[row, layer + 1])]
        place = f"layer {layer + 1} of the snowpack at {data.get_index(label)[row]}"
        allowed = "strictly increasing from the surface down"
        raise invalid(DEPTH_KEY, pair, allowed, f"{place}; {LAYER_DIM} 0 is at the top")
    elsewhere = [name for name, v in data.coords.items() if not set(v.dims) <= {label}]
    coordinates = data.drop_vars([*data.data_vars, *elsewhere])
    return SnowPackInput(label, coordinates, values, layered - {DEPTH_KEY}, zenith, pack_ground)


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
    if labels.to_frame().isna().to_numpy().any():
        raise invalid(label, "a gap", "a label for each snowpack", "masked, NaN or missing")
    duplicates = labels[labels.duplicated()]
    if duplicates.size:
        hint = f"{duplicates.size} of {labels.size} labels repeat an earlier one"
        raise invalid(label, str(duplicates[0]), "different for each snowpack", hint)
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


def _read_ground(data: xr.Dataset, label: str, given: Any) -> tuple[SnowPackGround, xr.Dataset]:
    """Return the ground that is given, or else that of a dataset, and the dataset without it."""
    index = data.get_index(label)
    rest = data.drop_vars([GROUND_KEY, GROUND_ATTRIBUTE, WAVELENGTH_DIM], errors="ignore")
    if given is not None:
        return SnowPackGround.from_input(given, label, index), rest
    albedo = None
    if GROUND_KEY in data:
        variable = data[GROUND_KEY].drop_vars(
            [name for name in data[GROUND_KEY].coords if name not in (label, WAVELENGTH_DIM)]
        )
        if not variable.ndim:
            variable = variable.expand_dims({label: index})
        albedo = SnowPackGround.from_input(variable, label, index)
    if GROUND_ATTRIBUTE not in data:
        return albedo or SnowPackGround.from_attributes(data.attrs), rest
    names = data[GROUND_ATTRIBUTE]
    if names.dims != (label,):
        raise invalid(f"{GROUND_ATTRIBUTE} dimensions", names.dims, f"over {label}")
    return SnowPackGround.from_names(names.values, data.attrs, albedo), rest


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
    if (rows < 0).any():
        raise invalid(label, "a gap", "a label in each row", "masked, NaN or missing")
    table = pd.DataFrame({"row": rows, "number": number})
    repeated = table.duplicated().to_numpy()
    if repeated.any():
        position = int(np.flatnonzero(repeated)[0])
        place = f"{labels[rows[position]]}, {number[position]:g}"
        raise invalid(f"{label}, {LAYER_DIM}", place, "different in each row", "rows repeat")
    if len(labels) > 1 and len(table) > len(labels) and table.number.is_unique:
        hint = "frame.groupby(label).cumcount() counts the layers of each snowpack"
        allowed = "numbers that begin again in each snowpack, 0 at the top"
        raise invalid(LAYER_DIM, f"{len(table)} different numbers", allowed, hint)
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
