"""Snowpacks of a season or of several sites: layers over time, with a quality flag for each."""

from __future__ import annotations

import datetime
from collections.abc import Hashable, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.arrays import align_to_labels
from splits.core.declarations import find_quantity
from splits.core.inputs import WAVELENGTH, Depth
from splits.core.keywords import declare_function
from splits.core.labels import convert_times
from splits.core.validation import (
    ROUNDING_TOLERANCE,
    InvalidValue,
    check_range,
    invalid,
    join_names,
    key_prefix,
    snap_to_limits,
)
from splits.io.netcdf import ANCILLARY_ATTRIBUTE
from splits.materials.impurities import MAX_NG_G
from splits.materials.library import interpolate_ice_density
from splits.materials.refractive_index import check_wavelength_range
from splits.media.ground import OPEN
from splits.media.snow import (
    MIN_NATURAL_DENSITY_KG_M3,
    OPTICAL_RADIUS_KEY,
    SURFACE_AREA_KEY,
    Snow,
    SnowTemperature,
    SurfaceArea,
)
from splits.media.snow_pack_input import (
    DEFAULTS,
    DENSITY_KEY,
    FLAG_NAME,
    GROUND_ATTRIBUTE,
    GROUND_KEY,
    IMPURITIES_KEY,
    LAYER_DIM,
    LAYER_FLAG_NAME,
    TEMPERATURE_KEY,
    THICKNESS_KEY,
    WATER_KEY,
    WAVELENGTH_DIM,
    ZENITH_KEY,
    PackGround,
    describe_variable,
    name_ground,
    read_input,
    store_ground,
)
from splits.media.stack import Stack

# --------------------------------------------------------------------------------------------------
# Quality of snowpacks: absent layers, missing values, ranges, night.

FLAGS = {"good": 0, "no_snow": 1, "missing_value": 2, "out_of_range": 3, "night": 4}
"""Flags of snowpacks; of several reasons, the first in this order is the flag."""
FLAG_LABEL = "quality of the snowpack"
LAYER_FLAGS = {"present": 0, "absent": 1}
"""Flags of layers."""
HORIZON_DEG = 90.0
"""Zenith angle from which on the sun is below the horizon."""
_DECLARED = {THICKNESS_KEY: Depth, SURFACE_AREA_KEY: SurfaceArea, TEMPERATURE_KEY: SnowTemperature}
RANGES = {
    DENSITY_KEY: (MIN_NATURAL_DENSITY_KG_M3, np.inf),
    WATER_KEY: (0.0, np.inf),
    **{n: (one.low, one.high) for n, kind in _DECLARED.items() if (one := find_quantity(kind))},
}
"""Ranges of `splits.Snow.natural`; the density of ice and the porosity limit the first two."""


def complete_dataset(given: xr.Dataset, ground: PackGround) -> xr.Dataset:
    """Return the dataset of `SnowPacks` for its input, with flags and attributes.

    A layer is absent if its thickness is 0, or if its thickness and all other variables given for
    each layer are NaN.  Absent layers follow the others, and all of their variables are NaN.

    Parameters
    ----------
    given : xarray.Dataset
        See `splits.media.snow_pack_input.read_input`.
    ground : Ground, xarray.DataArray or None
    """
    (label,) = (str(dim) for dim in given.dims if dim != LAYER_DIM)
    albedo = ground if isinstance(ground, xr.DataArray) else None
    common = None if isinstance(ground, xr.DataArray) else ground
    zenith = None
    if ZENITH_KEY in given:
        zenith = np.array(given[ZENITH_KEY].variable.set_dims({label: given.sizes[label]}))
        given = given.drop_vars(ZENITH_KEY)
    dims = (label, LAYER_DIM)
    sizes = {dim: given.sizes[dim] for dim in dims}
    values = {str(n): one.variable.set_dims(sizes).values for n, one in given.data_vars.items()}
    thickness = values[THICKNESS_KEY]
    described = [
        ~np.isnan(values[str(name)]) for name, one in given.data_vars.items()
        if LAYER_DIM in one.dims and name != THICKNESS_KEY
    ]  # fmt: skip
    is_absent = (thickness == 0.0) | (np.isnan(thickness) & ~np.any(described, axis=0))
    for name, default in DEFAULTS.items():
        values.setdefault(name, np.full(thickness.shape, default))
    order = np.argsort(is_absent, axis=1, kind="stable")
    is_absent = np.take_along_axis(is_absent, order, axis=1)
    for name, numbers in values.items():
        values[name] = np.where(is_absent, np.nan, np.take_along_axis(numbers, order, axis=1))
    for name in (TEMPERATURE_KEY, WATER_KEY):
        values[name] = snap_to_limits(values[name], *RANGES[name])
    if OPTICAL_RADIUS_KEY in values:
        # A radius of 0 or less becomes an area that is finite and out of range.
        radius_um = np.maximum(values.pop(OPTICAL_RADIUS_KEY), 1e-9)
        ice = interpolate_ice_density(values[TEMPERATURE_KEY])
        values[SURFACE_AREA_KEY] = 3e6 / (ice * radius_um)
    variables: dict[str, Any] = {
        name: (dims, numbers, f"{LAYER_FLAG_NAME} {FLAG_NAME}") for name, numbers in values.items()
    }
    if zenith is not None:
        variables[ZENITH_KEY] = (label, zenith, FLAG_NAME)
    if albedo is not None:
        variables[GROUND_KEY] = (albedo.dims, albedo.values, FLAG_NAME)
    for name, (dimensions, numbers, ancillary) in variables.items():
        long_name, units = describe_variable(name)
        attrs = {"long_name": long_name, "units": units, ANCILLARY_ATTRIBUTE: ancillary}
        variables[name] = (dimensions, numbers, attrs)
    flags = compute_flags(values, is_absent, zenith, albedo)
    if albedo is None:
        names: Any = np.full(flags.size, name_ground(common), dtype=object)
        attrs = {"long_name": "ground below the snowpack"}
        variables[GROUND_ATTRIBUTE] = (label, names, attrs)
    variables[FLAG_NAME] = (label, flags, describe_flags(FLAG_LABEL, FLAGS))
    layer_flags = is_absent.astype(np.int8) * np.int8(LAYER_FLAGS["absent"])
    attrs = describe_flags("whether the layer is absent", LAYER_FLAGS)
    variables[LAYER_FLAG_NAME] = (dims, layer_flags, attrs)
    dataset = given.drop_vars(given.data_vars)
    if label not in dataset.coords:
        dataset = dataset.assign_coords({label: np.arange(flags.size)})
    coordinate = dataset[label]
    if coordinate.dtype.kind == "M":
        coordinate.attrs = {
            "standard_name": "time", "long_name": "time", "units_metadata": "leap_seconds: none",
        }  # fmt: skip
    coordinate.attrs.setdefault("long_name", f"label of the snowpack: {label}")
    attrs = {
        "long_name": "number of the layer, 0 at the top", "units": "1",
        "axis": "Z", "positive": "down",
    }  # fmt: skip
    layers = {LAYER_DIM: (LAYER_DIM, np.arange(sizes[LAYER_DIM]), attrs)}
    dataset = dataset.assign_coords(layers).assign(variables)
    if albedo is not None and WAVELENGTH_DIM in albedo.coords:
        wavelengths = (WAVELENGTH_DIM, albedo[WAVELENGTH_DIM].values, WAVELENGTH.attributes)
        dataset = dataset.assign_coords({WAVELENGTH_DIM: wavelengths})
    of_ground = store_ground(common) if albedo is None else {}
    dataset.attrs = {"title": "Snowpacks", **of_ground}
    return dataset


def describe_flags(long_name: str, flags: Mapping[str, int]) -> dict[str, Any]:
    """Return the attributes of a flag variable by the CF conventions (section 3.5)."""
    return {
        "long_name": long_name,
        "flag_values": np.array(list(flags.values()), dtype=np.int8),
        "flag_meanings": " ".join(flags),
    }


def compute_flags(
    values: Mapping[str, np.ndarray], is_absent: np.ndarray, zenith: np.ndarray | None,
    albedo: xr.DataArray | None,
) -> np.ndarray:  # fmt: skip
    """Return the flag of each snowpack, one of `FLAGS`.

    Parameters
    ----------
    values : mapping of float, shape (snowpacks, layers)
        Variables of layers, NaN where these are absent.
    is_absent : bool, shape (snowpacks, layers)
    zenith : float, shape (snowpacks,), or None
        Zenith angles of the sun (degrees).
    albedo : xarray.DataArray or None
        Of the ground below each.
    """
    # A layer outside the range of `splits.Snow.natural`.
    ice = interpolate_ice_density(values[TEMPERATURE_KEY])
    porosity = 1.0 - values[DENSITY_KEY] / ice
    has_outlier = values[DENSITY_KEY] >= ice
    has_outlier |= values[WATER_KEY] > porosity * (1.0 + ROUNDING_TOLERANCE)
    is_missing = np.zeros(len(is_absent), dtype=bool)
    for name, numbers in values.items():
        low, high = RANGES.get(name, (0.0, MAX_NG_G))
        snapped = snap_to_limits(numbers, low, high)
        has_outlier |= (snapped < low) | (snapped > high)
        is_missing |= (np.isnan(numbers) & ~is_absent).any(axis=1)
    is_outside = has_outlier.any(axis=1)
    flags = np.full(is_missing.size, FLAGS["good"], dtype=np.int8)
    for given, high in ((zenith, 180.0), (albedo, 1.0)):
        if given is not None:
            by_snowpack = np.asarray(given).reshape(flags.size, -1)
            is_missing |= np.isnan(by_snowpack).any(axis=1)
            is_outside |= ((by_snowpack < 0.0) | (by_snowpack > high)).any(axis=1)
    if zenith is not None:
        flags[zenith >= HORIZON_DEG] = FLAGS["night"]
    flags[is_outside] = FLAGS["out_of_range"]
    flags[is_missing] = FLAGS["missing_value"]
    flags[is_absent.all(axis=1)] = FLAGS["no_snow"]
    return flags


def count_missing_results(dataset: xr.Dataset) -> str:
    """Return the numbers of snowpacks without a result by the meaning of their flag, or ""."""
    flag = dataset.quality_flag
    meanings = flag.attrs["flag_meanings"].split()
    return ", ".join(
        f"{int((flag == value).sum())} {meaning.replace('_', ' ')}"
        for value, meaning in zip(flag.attrs["flag_values"], meanings, strict=True)
        if value != 0 and (flag == value).any()
    )


# --------------------------------------------------------------------------------------------------
# Snowpacks of a season or of several sites: layers over time, with a quality flag for each.


class SnowPacks:
    """Snowpacks over time, or over another label, and layers; layer 0 is at the top.

    Snowpacks that cannot be used get a flag and raise no error, so that one gap does not stop a
    season.  Errors are raised only for the structure of the data: missing or unknown variables,
    wrong dimensions or units, repeated labels, and depths that do not increase.

    Parameters
    ----------
    data : xarray.Dataset or pandas.DataFrame
        A dataset over the label and ``layer``, or a table with columns of these names and one row
        per layer.  Variables:

        - ``thickness_m`` and ``density_kg_m3``, the mass of ice per volume of snow, without water;
        - ``specific_surface_area_m2_kg``, or ``optical_radius_um``;
        - ``temperature_c`` (optional, −1), ``liquid_water_content`` (optional, volume of water per
          volume of snow, 0);
        - ``impurities_ng_g.black_carbon`` and others (optional), mass per mass of ice;
        - ``sun_zenith_deg`` (optional), zenith angle of the sun, over the label only;
        - ``ground_albedo`` (optional), over the label, or over the label and ``wavelength`` (nm);
        - ``depth_top_m`` (optional), depth of the top of each layer; only its order is checked.

        The attribute ``units`` of a variable is checked, and its values are converted: m, cm, mm;
        kg m-3, g cm-3; m2 kg-1, cm2 g-1; degC, K; 1, %; ng g-1, ug g-1, g g-1; degree, rad.
        Without it, the unit is that of the name.
    label : str, optional
        Dimension or column of the snowpacks; by default the dimension other than ``layer``, or the
        column ``time``.  Labels are texts, numbers, or times, also as texts of ISO 8601; those with
        a zone become times in UTC, and those without one are in UTC.
    ground : number, str, mapping, path or array_like, optional
        Ground below all snowpacks, as for `splits.Stack`; or an albedo for each: a sequence, or an
        array over the label, or over the label and ``wavelength``.  It replaces that of the data.

    Attributes
    ----------
    dataset : xarray.Dataset
        Variables as listed, with ``specific_surface_area_m2_kg`` in place of the radius and with
        the defaults.  ``quality_flag`` over the label is one of good, no_snow, missing_value,
        out_of_range, night; the attribute ``flag_values`` lists the numbers, and ``comment`` names
        the first value out of range.  ``layer_flag`` is 1 for absent layers.  A ground for all is
        in the attributes, and its name is the variable ``ground`` over the label, so that datasets
        can be concatenated.

    Raises
    ------
    ValueError
        For an invalid structure; the message names the variable.

    Notes
    -----
    A layer is absent if its thickness is 0, or if its thickness and all other values given for it
    are NaN.  Absent layers are moved below the others and hold NaN.  A NaN in a present layer, or a
    NaN thickness beside other values, is a missing value.  Infinite values count as NaN.  Ranges
    are those of `splits.Snow.natural`.  At night the sun is at the horizon or below it.  If several
    flags apply, the first in the order no_snow, missing_value, out_of_range, night is set.

    Examples
    --------
    >>> import pandas as pd
    >>> from splits import SnowPacks
    >>> columns = ["time", "layer", "thickness_m", "density_kg_m3", "specific_surface_area_m2_kg"]
    >>> rows = [("a", 0, 0.1, 120, 40), ("a", 1, 0.5, 350, 12), ("b", 0, 0.2, None, 30)]
    >>> SnowPacks(pd.DataFrame(rows, columns=columns))
    SnowPacks(2 over time, at most 2 layers: 1 good, 1 missing_value)
    """

    kind = "snow_packs"

    @declare_function
    def __init__(
        self, data: xr.Dataset | pd.DataFrame, label: str | None = None, *, ground: Any = None
    ) -> None:
        given, self._ground = read_input(data, label, ground)
        self.dataset = complete_dataset(given, self._ground)
        flag = self.dataset[FLAG_NAME]
        for position in np.flatnonzero(flag.values == FLAGS["out_of_range"])[:1].tolist():
            first = f"{self.label} {self.dataset.get_index(self.label)[position]}"
            flag.attrs["comment"] = f"out of range: {first}: {self._find_obstacle(position)}"

    def __repr__(self) -> str:
        """Return the numbers of snowpacks, layers and flags."""
        counts = [f"{number} {name}" for name, number in self.count_flags().items() if number]
        sizes = f"{self.dataset.sizes[self.label]} over {self.label}"
        n_layers = self.dataset.sizes[LAYER_DIM]
        ground = self._describe_ground()
        below = "" if ground == OPEN else f", ground: {ground}"
        return f"SnowPacks({sizes}, at most {n_layers} layers{below}: {', '.join(counts)})"

    def __len__(self) -> int:
        """Return the number of snowpacks, including those with flags."""
        return self.dataset.sizes[self.label]

    @property
    def label(self) -> str:
        """Name of the dimension of the snowpacks."""
        return str(self.dataset[FLAG_NAME].dims[0])

    @property
    def impurities(self) -> tuple[str, ...]:
        """Types of the impurities."""
        start = f"{IMPURITIES_KEY}."
        return tuple(
            str(n).removeprefix(start) for n in self.dataset.data_vars if str(n).startswith(start)
        )

    @property
    def is_good(self) -> np.ndarray:
        """Whether each snowpack is good, bool, shape (snowpacks,)."""
        return self.dataset[FLAG_NAME].values == FLAGS["good"]

    def count_flags(self) -> dict[str, int]:
        """Return the number of snowpacks by name of the flag."""
        flags = self.dataset[FLAG_NAME].values
        return {name: int((flags == value).sum()) for name, value in FLAGS.items()}

    @declare_function
    def with_sun_zenith(self, sun_zenith_deg: Any) -> SnowPacks:
        """Return the snowpacks with other zenith angles of the sun, and with new flags.

        Parameters
        ----------
        sun_zenith_deg : float or array_like
            Zenith angle (degrees, 0 to 180) for each snowpack, or for all; values with labels are
            matched to the snowpacks by label.  NaN is a missing value.
        """
        labels = self.dataset.get_index(self.label).tolist()
        values = align_to_labels(
            ZENITH_KEY, sun_zenith_deg, labels, allowed="numbers in degrees", allow_gaps=True
        )
        if values.shape not in ((), (len(self),)):
            allowed = f"a number, or {len(self)} numbers"
            raise invalid(ZENITH_KEY, f"numbers of shape {values.shape}", allowed)
        zenith = (self.label, np.broadcast_to(values, (len(self),)))
        return SnowPacks(self.dataset.assign({ZENITH_KEY: zenith}))

    @declare_function
    def with_ground(self, ground: Any) -> SnowPacks:
        """Return the snowpacks over another ground, and with new flags.

        Parameters
        ----------
        ground : number, str, mapping, path or array_like
            As for `splits.SnowPacks`; "open" for none.
        """
        return SnowPacks(self.dataset, self.label, ground=ground)

    @declare_function
    def compute_ground_albedo(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the albedo below the good snowpacks at wavelengths (nm), 0 for open ones.

        Returns
        -------
        float, shape (good, wavelengths)
        """
        shape = (int(self.is_good.sum()), wavelength_nm.size)
        ground = self._ground
        if not isinstance(ground, xr.DataArray):
            reflecting = ground if ground and ground.is_reflecting else None
            values = reflecting.albedo(wavelength_nm) if reflecting else 0.0
            return np.broadcast_to(values, shape)
        albedo = ground.values[self.is_good]
        if albedo.ndim == 1:
            return np.broadcast_to(albedo[:, np.newaxis], shape)
        known = ground[WAVELENGTH_DIM].values
        inside = check_wavelength_range(
            wavelength_nm, known[0], known[-1], "the ground of the snowpacks"
        )
        return np.reshape([np.interp(inside, known, row) for row in albedo], shape)

    def _describe_ground(self) -> str:
        """Return the ground in a few words."""
        if isinstance(self._ground, xr.DataArray):
            return "an albedo for each snowpack"
        return OPEN if self._ground is None else self._ground.name

    def describe(self) -> dict[str, Any]:
        """Return attributes for datasets of results."""
        n_good = self.count_flags()["good"]
        return {
            "label": self.label, "count": len(self), "good": n_good,
            "ground": self._describe_ground(),
        }  # fmt: skip

    def select_good(self) -> xr.Dataset:
        """Return the good snowpacks with the same number of layers, without NaN.

        Layers below the last one of a snowpack have thickness 0 and its other properties, and
        ``n_layers`` over the label is the number of the others.
        """
        rows = self.dataset.isel({self.label: self.is_good})
        is_present = rows[LAYER_FLAG_NAME].values == LAYER_FLAGS["present"]
        n_layers = is_present.sum(axis=1)
        depth = int(n_layers.max(initial=0))
        source = np.minimum(np.arange(depth), n_layers[:, np.newaxis] - 1)
        rows = rows.isel({LAYER_DIM: slice(depth)}).drop_vars(LAYER_FLAG_NAME)
        for name, variable in rows.data_vars.items():
            if LAYER_DIM in variable.dims:
                rows[name] = variable.copy(data=np.take_along_axis(variable.values, source, axis=1))
        rows[THICKNESS_KEY] = rows[THICKNESS_KEY].where(is_present[:, :depth], 0.0)
        return rows.assign(n_layers=(self.label, n_layers))

    @declare_function
    def make_stack(self, label: Hashable, ground: Any = None) -> Stack:
        """Return one good snowpack as a stack of layers of `splits.Snow.natural`.

        Parameters
        ----------
        label : object
            Label of the snowpack, such as a time.
        ground : number, str, mapping or path, optional
            Ground below it, as for `splits.Stack`; by default that of the snowpacks.

        Raises
        ------
        ValueError
            For an unknown label, and for a snowpack that is not good.
        """
        index = self.dataset.get_index(self.label)
        if isinstance(index, pd.DatetimeIndex) and isinstance(label, datetime.date | str):
            label = convert_times(pd.Index([label], dtype=object))[0]
        try:
            position = index.get_loc(label)
        except (KeyError, TypeError, pd.errors.InvalidIndexError):
            position = None
        if not isinstance(position, int):
            examples = [str(name) for name in index[:3]]
            allowed = f"the label of a snowpack, such as {join_names(examples)}"
            raise invalid(self.label, str(label), allowed)
        if not self.is_good[position]:
            flag = [*FLAGS][int(self.dataset[FLAG_NAME].values[position])]
            hint = f"{FLAG_NAME} is {flag}"
            hint += f": {self._find_obstacle(position)}" if flag == "out_of_range" else ""
            raise invalid(self.label, str(label), "a good snowpack", hint)
        return self._make_stack(position, ground)

    @declare_function
    def iterate_stacks(self, ground: Any = None) -> Iterator[tuple[Any, Stack]]:
        """Iterate over the good snowpacks, as pairs of label and stack; see `make_stack`.

        Parameters
        ----------
        ground : number, str, mapping or path, optional
            Ground below all of them, as for `splits.Stack`; by default that of the snowpacks.
        """
        index = self.dataset.get_index(self.label)
        return (
            (index[position], self._make_stack(position, ground))
            for position in np.flatnonzero(self.is_good).tolist()
        )

    def _find_obstacle(self, position: int) -> str:
        """Return the message on the first value out of range of the snowpack at a position."""
        try:
            if ZENITH_KEY in self.dataset:
                zenith = self.dataset[ZENITH_KEY].values[position]
                check_range(ZENITH_KEY, zenith, 0.0, 180.0, "degrees")
            self._make_stack(position, None)
        except InvalidValue as error:
            return str(error).replace("depth_m", THICKNESS_KEY)
        return ""

    def _make_stack(self, position: int, ground: Any) -> Stack:
        """Return the snowpack at a position."""
        variables = self.dataset.drop_vars(GROUND_KEY, errors="ignore").data_vars
        values = {str(n): v.values[position] for n, v in variables.items()}
        n_layers = int((values[LAYER_FLAG_NAME] == LAYER_FLAGS["present"]).sum())
        layers = []
        for layer in range(n_layers):
            with key_prefix(f"layers.{layer}"):
                snow = Snow.natural(
                    depth_m=values[THICKNESS_KEY][layer],
                    density_kg_m3=values[DENSITY_KEY][layer],
                    specific_surface_area_m2_kg=values[SURFACE_AREA_KEY][layer],
                    temperature_c=values[TEMPERATURE_KEY][layer],
                    liquid_water_content=values[WATER_KEY][layer],
                    impurities_ng_g={
                        kind: values[f"{IMPURITIES_KEY}.{kind}"][layer] for kind in self.impurities
                    },
                )
            layers.append(snow)
        own = self._ground
        if isinstance(own, xr.DataArray):
            # A spectrum, or a number.
            own = own[position] if own.ndim > 1 else own.values[position].item()
        return Stack(tuple(layers), ground=own if ground is None else ground)
