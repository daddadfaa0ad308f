"""Snowpacks of a season or of several sites: layers over time, with a quality flag for each."""

from __future__ import annotations

import datetime
from collections.abc import Hashable, Iterator, Mapping
from typing import Any, NamedTuple

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
    SnowPackInput,
    describe_variable,
    read_input,
)
from splits.media.stack import Stack

# --------------------------------------------------------------------------------------------------
# Quality of snowpacks: absent layers, missing values, ranges, night.

FLAGS = {"good": 0, "no_snow": 1, "missing_value": 2, "out_of_range": 3, "night": 4}
"""Flags of snowpacks; of several reasons, the first in this order is the flag."""
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


def make_dataset(given: SnowPackInput) -> xr.Dataset:
    """Return the checked dataset with its flags."""
    values, is_absent = complete_layers(given)
    flags = compute_flags(values, is_absent, given)
    dims = (given.label, LAYER_DIM)
    variables: dict[str, Any] = {
        name: (dims, numbers, f"{LAYER_FLAG_NAME} {FLAG_NAME}") for name, numbers in values.items()
    }
    if given.sun_zenith_deg is not None:
        variables[ZENITH_KEY] = (given.label, given.sun_zenith_deg, FLAG_NAME)
    if given.ground.albedo is not None:
        dimensions = (given.label, WAVELENGTH_DIM)[: given.ground.albedo.ndim]
        variables[GROUND_KEY] = (dimensions, given.ground.albedo, FLAG_NAME)
    for name, (dimensions, numbers, ancillary) in variables.items():
        long_name, units = describe_variable(name)
        attrs = {"long_name": long_name, "units": units, ANCILLARY_ATTRIBUTE: ancillary}
        variables[name] = (dimensions, numbers, attrs)
    if given.ground.albedo is None:
        names = np.full(flags.size, given.ground.get_name(), dtype=object)
        attrs = {"long_name": "ground below the snowpack"}
        variables[GROUND_ATTRIBUTE] = (given.label, names, attrs)
    variables[FLAG_NAME] = (given.label, flags, _describe_flags("quality of the snowpack", FLAGS))
    layer_flags = is_absent.astype(np.int8) * np.int8(LAYER_FLAGS["absent"])
    variables[LAYER_FLAG_NAME] = (
        dims,
        layer_flags,
        _describe_flags("whether the layer is absent", LAYER_FLAGS),
    )
    number = np.arange(is_absent.shape[1])
    attrs = {
        "long_name": "number of the layer, 0 at the top", "units": "1",
        "axis": "Z", "positive": "down",
    }  # fmt: skip
    coordinates = given.coordinates.copy()
    if given.label not in coordinates.coords:
        coordinates = coordinates.assign_coords({given.label: np.arange(flags.size)})
    label = coordinates[given.label]
    if label.dtype.kind == "M":
        label.attrs = {
            "standard_name": "time", "long_name": "time", "units_metadata": "leap_seconds: none",
        }  # fmt: skip
    label.attrs.setdefault("long_name", f"label of the snowpack: {given.label}")
    dataset = coordinates.assign_coords({LAYER_DIM: (LAYER_DIM, number, attrs)}).assign(variables)
    if given.ground.wavelength_nm is not None:
        coordinate = (WAVELENGTH_DIM, given.ground.wavelength_nm, WAVELENGTH.attributes)
        dataset = dataset.assign_coords({WAVELENGTH_DIM: coordinate})
    dataset.attrs = {"title": "Snowpacks", **given.ground.make_attributes()}
    return dataset


def _describe_flags(long_name: str, flags: dict[str, int]) -> dict[str, Any]:
    """Return the attributes of a flag variable by the CF conventions (section 3.5)."""
    return {
        "long_name": long_name,
        "flag_values": np.array(list(flags.values()), dtype=np.int8),
        "flag_meanings": " ".join(flags),
    }


def complete_layers(given: SnowPackInput) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the variables of layers in their final form, and which layers are absent.

    A layer is absent if its thickness is 0, or if its thickness and all other variables given for
    each layer are NaN.  Absent layers follow the others, and all of their variables are NaN.
    """
    thickness = given.values[THICKNESS_KEY]
    described = [~np.isnan(given.values[name]) for name in given.layered - {THICKNESS_KEY}]
    is_absent = (thickness == 0.0) | (np.isnan(thickness) & ~np.any(described, axis=0))
    defaults = {name: np.full(thickness.shape, default) for name, default in DEFAULTS.items()}
    values = given.values | {n: one for n, one in defaults.items() if n not in given.values}
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
    return values, is_absent


def compute_flags(
    values: Mapping[str, np.ndarray], is_absent: np.ndarray, given: SnowPackInput
) -> np.ndarray:
    """Return the flag of each snowpack, one of `FLAGS`.

    Parameters
    ----------
    values : mapping of float, shape (snowpacks, layers)
        As returned by `complete_layers`.
    is_absent : bool, shape (snowpacks, layers)
    given : SnowPackInput
        With the zenith angles of the sun and the ground.
    """
    is_missing = np.any(
        [(np.isnan(numbers) & ~is_absent).any(axis=1) for numbers in values.values()], axis=0
    )
    # A layer outside the range of `splits.Snow.natural`.
    ice = interpolate_ice_density(values[TEMPERATURE_KEY])
    porosity = 1.0 - values[DENSITY_KEY] / ice
    has_outlier = values[DENSITY_KEY] >= ice
    has_outlier |= values[WATER_KEY] > porosity * (1.0 + ROUNDING_TOLERANCE)
    for name, numbers in values.items():
        low, high = RANGES.get(name, (0.0, MAX_NG_G))
        snapped = snap_to_limits(numbers, low, high)
        has_outlier |= (snapped < low) | (snapped > high)
    is_outside = has_outlier.any(axis=1)
    flags = np.full(is_missing.size, FLAGS["good"], dtype=np.int8)
    sun_zenith_deg, albedo = given.sun_zenith_deg, given.ground.albedo
    if albedo is not None:
        by_snowpack = albedo.reshape(flags.size, -1)
        is_missing |= np.isnan(by_snowpack).any(axis=1)
        is_outside |= ((by_snowpack < 0.0) | (by_snowpack > 1.0)).any(axis=1)
    if sun_zenith_deg is not None:
        flags[sun_zenith_deg >= HORIZON_DEG] = FLAGS["night"]
        is_missing |= np.isnan(sun_zenith_deg)
        is_outside |= (sun_zenith_deg < 0.0) | (sun_zenith_deg > 180.0)
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
# Snowpacks as arrays of the same number of layers, for solvers of many snowpacks at once.


class SnowPackArrays(NamedTuple):
    """Good snowpacks as arrays of the same number of layers, without NaN.

    Layers below the last one of a snowpack have thickness 0 and its other properties.

    Attributes
    ----------
    positions : int, shape (good,)
        Positions of the good snowpacks along the dimension of the dataset.
    n_layers : int, shape (good,)
        Number of layers present.
    thickness_m, density_kg_m3, specific_surface_area_m2_kg, temperature_c, liquid_water_content
        Properties of the layers, float, shape (good, layers).
    impurities_ng_g : dict of float, shape (good, layers)
        Mass of impurities per mass of ice (ng/g) by type.
    sun_zenith_deg : float, shape (good,), or None
    """

    positions: np.ndarray
    n_layers: np.ndarray
    thickness_m: np.ndarray
    density_kg_m3: np.ndarray
    specific_surface_area_m2_kg: np.ndarray
    temperature_c: np.ndarray
    liquid_water_content: np.ndarray
    impurities_ng_g: dict[str, np.ndarray]
    sun_zenith_deg: np.ndarray | None


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
        given = read_input(data, label, ground)
        self.dataset, self._ground = make_dataset(given), given.ground
        flag = self.dataset[FLAG_NAME]
        for position in np.flatnonzero(flag.values == FLAGS["out_of_range"])[:1].tolist():
            first = f"{self.label} {self.dataset.get_index(self.label)[position]}"
            flag.attrs["comment"] = f"out of range: {first}: {self._find_obstacle(position)}"

    def __repr__(self) -> str:
        """Return the numbers of snowpacks, layers and flags."""
        counts = [f"{number} {name}" for name, number in self.count_flags().items() if number]
        sizes = f"{self.dataset.sizes[self.label]} over {self.label}"
        n_layers = self.dataset.sizes[LAYER_DIM]
        ground = self._ground.describe()
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
        return self._ground.compute_albedo(wavelength_nm, np.flatnonzero(self.is_good))

    def describe(self) -> dict[str, Any]:
        """Return attributes for datasets of results."""
        n_good = self.count_flags()["good"]
        return {
            "label": self.label, "count": len(self), "good": n_good,
            "ground": self._ground.describe(),
        }  # fmt: skip

    @declare_function
    def to_arrays(self) -> SnowPackArrays:
        """Return the good snowpacks as arrays for solvers of many snowpacks at once."""
        positions = np.flatnonzero(self.is_good)
        rows = self.dataset.isel({self.label: positions})
        is_present = rows[LAYER_FLAG_NAME].values == LAYER_FLAGS["present"]
        n_layers = is_present.sum(axis=1)
        depth = int(n_layers.max(initial=0))
        # Below the last layer, its properties are repeated.
        source = np.minimum(np.arange(depth), n_layers[:, np.newaxis] - 1)

        def fill(name: str) -> np.ndarray:
            return np.take_along_axis(rows[name].values, source, axis=1)

        return SnowPackArrays(
            positions,
            n_layers,
            np.where(is_present[:, :depth], fill(THICKNESS_KEY), 0.0),
            fill(DENSITY_KEY),
            fill(SURFACE_AREA_KEY),
            fill(TEMPERATURE_KEY),
            fill(WATER_KEY),
            {kind: fill(f"{IMPURITIES_KEY}.{kind}") for kind in self.impurities},
            rows[ZENITH_KEY].values if ZENITH_KEY in rows else None,
        )

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
        own = self._ground.get_ground(position) if ground is None else ground
        return Stack(tuple(layers), ground=own)
