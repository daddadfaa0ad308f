"""Snowpacks of a season or of several sites: layers over time, with a quality flag for each."""

from __future__ import annotations

import datetime
from collections.abc import Hashable, Iterator
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.arrays import align_to_labels
from splits.core.keywords import reject_unknown_arguments
from splits.core.labels import convert_times
from splits.core.validation import InvalidValue, check_range, invalid, join_names, key_prefix
from splits.media.ground import OPEN
from splits.media.measured_inputs import SURFACE_AREA_KEY
from splits.media.pack_ground import GROUND_KEY
from splits.media.snow import Snow
from splits.media.snow_pack_arrays import SnowPackArrays
from splits.media.snow_pack_input import (
    DENSITY_KEY,
    FLAG_NAME,
    IMPURITIES_KEY,
    LAYER_DIM,
    LAYER_FLAG_NAME,
    TEMPERATURE_KEY,
    THICKNESS_KEY,
    WATER_KEY,
    ZENITH_KEY,
    read_input,
)
from splits.media.snow_pack_quality import FLAGS, LAYER_FLAGS, make_dataset
from splits.media.stack import Stack

MAX_LISTED_LABELS = 3
"""Number of labels of an example in messages."""


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

    @reject_unknown_arguments
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
    def kind(self) -> str:
        """Name of the kind of medium in datasets of results."""
        return "snow_packs"

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

    @reject_unknown_arguments
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
        values = np.broadcast_to(values, (len(self),))
        return SnowPacks(self.dataset.assign({ZENITH_KEY: (self.label, values)}))

    @reject_unknown_arguments
    def with_ground(self, ground: Any) -> SnowPacks:
        """Return the snowpacks over another ground, and with new flags.

        Parameters
        ----------
        ground : number, str, mapping, path or array_like
            As for `splits.SnowPacks`; "open" for none.
        """
        return SnowPacks(self.dataset, self.label, ground=ground)

    @reject_unknown_arguments
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

    @reject_unknown_arguments
    def to_arrays(self) -> SnowPackArrays:
        """Return the good snowpacks as arrays for solvers of many snowpacks at once."""
        return SnowPackArrays.from_dataset(
            self.dataset, np.flatnonzero(self.is_good), self.label, self.impurities
        )

    @reject_unknown_arguments
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
            examples = [str(name) for name in index[:MAX_LISTED_LABELS]]
            allowed = f"the label of a snowpack, such as {join_names(examples)}"
            raise invalid(self.label, str(label), allowed)
        if not self.is_good[position]:
            names = {value: name for name, value in FLAGS.items()}
            flag = names[int(self.dataset[FLAG_NAME].values[position])]
            hint = f"{FLAG_NAME} is {flag}"
            hint += f": {self._find_obstacle(position)}" if flag == "out_of_range" else ""
            raise invalid(self.label, str(label), "a good snowpack", hint)
        return self._make_stack(position, ground)

    @reject_unknown_arguments
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
