"""Ground below the snowpacks of `splits.SnowPacks`: one for all, or an albedo for each.

A ground for all is in the attributes of the dataset of snowpacks, and its name is the variable
``ground`` over the label.  An albedo for each is the variable ``ground_albedo`` over the label, or
over the label and ``wavelength``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
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
from splits.core.units import check_nanometres
from splits.core.validation import invalid
from splits.materials.refractive_index import check_wavelength_range
from splits.media.ground import (
    BLACK,
    OPEN,
    TABLE_NAME,
    WAVELENGTH_DIM,
    Ground,
    is_ground_spectrum,
)

GROUND_KEY = "ground_albedo"
GROUND_ATTRIBUTE = "ground"
_TABLE_ATTRIBUTES = ("ground_wavelength_nm", "ground_values")


class PackGround(NamedTuple):
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
    def from_input(cls, value: Any, label: str, labels: pd.Index) -> PackGround:
        """Return the ground for a user's value, see `splits.SnowPacks`.

        Parameters
        ----------
        value : object
        label : str
            Dimension of the snowpacks.
        labels : pandas.Index
            Labels of the snowpacks.
        """
        if is_ground_spectrum(value):
            return cls(Ground.from_input(value))
        if isinstance(value, xr.DataArray) and value.ndim:
            return cls._from_array(value, label, labels)
        is_row = isinstance(value, np.ndarray | pd.Series | Sequence) and not isinstance(value, str)
        if not is_row or not np.ndim(value):
            return cls(Ground.from_input(value))
        albedo = align_to_labels(GROUND_KEY, value, labels.tolist(), allow_gaps=True)
        if albedo.shape != (labels.size,):
            given = f"numbers of shape {albedo.shape}"
            raise invalid(GROUND_KEY, given, f"one ground, or {labels.size} albedos")
        return cls(albedo=albedo)

    @classmethod
    def _from_array(cls, value: xr.DataArray, label: str, labels: pd.Index) -> PackGround:
        """Return the ground of an array over the label, or over the label and wavelength."""
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
    def from_attributes(cls, attributes: Mapping[str, Any]) -> PackGround:
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
        cls, names: np.ndarray, attributes: Mapping[str, Any], albedo: PackGround | None
    ) -> PackGround:
        """Return the ground of snowpacks by its names, which differ after a concatenation.

        Parameters
        ----------
        names : str or missing, shape (snowpacks,)
            See `get_name`.
        attributes : mapping
            Those of `make_attributes` of one of the grounds.
        albedo : PackGround or None
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
            is_open = self.common is None or not self.common.is_reflecting
            common = 0.0 if is_open or self.common is None else self.common.albedo(wavelength_nm)
            return np.broadcast_to(common, shape)
        if self.wavelength_nm is None:
            return np.broadcast_to(self.albedo[positions, np.newaxis], shape)
        first, last = self.wavelength_nm[[0, -1]]
        inside = check_wavelength_range(wavelength_nm, first, last, "the ground of the snowpacks")
        rows = [np.interp(inside, self.wavelength_nm, self.albedo[row]) for row in positions]
        return np.reshape(rows, shape)


def _parse_name(name: str) -> float | str:
    """Return the albedo of a name that is a number; other names unchanged."""
    try:
        return float(name)
    except ValueError:
        return name
