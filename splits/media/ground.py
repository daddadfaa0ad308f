"""Lambertian ground below a sample, or an open lower boundary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import xarray as xr

from splits.core.arrays import ContentEquality, check_array_range
from splits.core.declarations import Quantity
from splits.core.labels import check_nanometres
from splits.core.validation import check_number, check_range, invalid, suggest_name
from splits.materials.csv_table import (
    is_csv_path,
    read_numeric_csv,
    read_tabulated_function,
    to_columns,
)
from splits.materials.refractive_index import check_wavelength_range
from splits.media.formatting import format_input

OPEN = "open"
BLACK = "black"
TABLE_NAME = "table"
"""Name of a ground given as numeric columns."""
WAVELENGTH_DIM = "wavelength"
"""Name of the wavelengths (nm) of arrays with labels."""
BLACK_OPTICAL_DEPTH = 1e4
"""Optical depth of a reflection from a black ground; exp(−1e4) underflows to 0."""


@dataclass(frozen=True, eq=False, repr=False)
class Ground(ContentEquality):
    """Lambertian ground with a constant or tabulated albedo.

    Attributes
    ----------
    name, source : str
        Name of the ground and source of its albedo.
    albedo_values : float, shape (n,)
        Albedo, 0 to 1.
    wavelength_nm : float, shape (n,) or None
        Wavelengths (nm), strictly increasing; None for a constant albedo, with n = 1.
    sha256 : str
        SHA-256 of a user's file, otherwise empty.
    """

    name: str
    source: str
    albedo_values: np.ndarray
    wavelength_nm: np.ndarray | None = None
    sha256: str = ""

    @staticmethod
    def from_input(value: Any) -> Ground | None:
        """Return the ground for a user's input, or None for an open lower boundary.

        Parameters
        ----------
        value : None, str, number, mapping, array, path or Ground
            ``"open"`` or None; ``"black"``; an albedo; a mapping of ``wavelength_nm`` and
            ``albedo``, lists; an array of albedos with labels, an `xarray.DataArray` over
            ``wavelength`` (nm) or a `pandas.Series` whose index has this name; the name of a soil,
            see `load_soils`; or the path of a CSV file with columns ``wavelength_nm, albedo``.

        Raises
        ------
        ValueError
            For an unknown name, a malformed table or an albedo outside 0 to 1.
        """
        if value is None or isinstance(value, Ground):
            return value
        value = to_columns(value)
        if is_ground_spectrum(value):
            if isinstance(value, xr.DataArray):
                check_nanometres("ground", value[WAVELENGTH_DIM])
                value = value.to_series()
            value = value.sort_index()
            value = {"wavelength_nm": value.index.to_numpy(), "albedo": value.to_numpy()}
        if isinstance(value, Mapping | Path) or (isinstance(value, str) and is_csv_path(value)):
            names = ("wavelength_nm", "albedo")
            (w, values), digest = read_tabulated_function("ground", value, names)
            values = check_array_range("ground.albedo", values, 0.0, 1.0)
            if isinstance(value, Mapping):
                return Ground(TABLE_NAME, "given by the user", values, w)
            return Ground(Path(value).name, "table of the user", values, w, digest)
        if isinstance(value, str):
            if value in (OPEN, BLACK):
                return None if value == OPEN else Ground(BLACK, "given by the user", np.zeros(1))
            soils = load_soils()
            if value not in soils:
                hint = suggest_name(value, [OPEN, BLACK, *soils]) or "soils: " + ", ".join(soils)
                raise invalid("ground", value, _ALLOWED_INPUT, hint)
            return soils[value]
        if np.ndim(value):
            hint = 'a spectrum is {"wavelength_nm": [...], "albedo": [...]}'
            raise invalid("ground", value, _ALLOWED_INPUT, hint)
        albedo = check_range("ground", check_number("ground", value, _ALLOWED_INPUT), 0.0, 1.0)
        return Ground(f"albedo {albedo!r}", "given by the user", np.array([albedo]))

    def as_input(self) -> Any:
        """Return the input of `from_input` for this ground; for a file, its name."""
        if self.name == TABLE_NAME:
            return {"wavelength_nm": self.wavelength_nm, "albedo": self.albedo_values}
        if self.wavelength_nm is None:
            return BLACK if self.name == BLACK else float(self.albedo_values[0])
        # Columns of soils are named SOIL_SAMPLE.
        return self.name if self.sha256 else self.name.partition("_")[0]

    def __repr__(self) -> str:
        """Return the call that constructs the ground, on one line."""
        return f"Ground.from_input({format_input(self)})"

    @property
    def is_reflecting(self) -> bool:
        """Whether the albedo is positive at any wavelength."""
        return bool((self.albedo_values > 0.0).any())

    def albedo(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the albedo at wavelengths (nm), linear between the rows of a table."""
        if self.wavelength_nm is None:
            return np.full(np.shape(wavelength_nm), self.albedo_values[0])
        first, last = self.wavelength_nm[[0, -1]]
        return np.interp(
            check_wavelength_range(wavelength_nm, first, last, f"ground {self.name}"),
            self.wavelength_nm,
            self.albedo_values,
        )

    def optical_depth(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the optical depth of a reflection, −ln(albedo), at wavelengths (nm)."""
        albedo = self.albedo(wavelength_nm)
        is_black = albedo <= np.exp(-BLACK_OPTICAL_DEPTH)
        return np.where(is_black, BLACK_OPTICAL_DEPTH, -np.log(np.where(is_black, 1.0, albedo)))


def is_ground_spectrum(value: Any) -> bool:
    """Return whether a user's input is an array of albedos over labelled wavelengths."""
    if isinstance(value, pd.Series):
        return value.index.name == WAVELENGTH_DIM
    is_array = isinstance(value, xr.DataArray)
    return is_array and value.dims == (WAVELENGTH_DIM,) and WAVELENGTH_DIM in value.coords


def describe_ground(ground: Ground | None) -> dict[str, Any]:
    """Return a ground as dataset attributes."""
    if ground is None:
        return {"ground": OPEN}
    attrs: dict[str, Any] = {"ground": ground.name}
    if ground.name == TABLE_NAME:
        attrs |= {
            "ground_wavelength_nm": ground.wavelength_nm,
            "ground_albedo": ground.albedo_values,
        }
    return attrs | ({"ground_sha256": ground.sha256} if ground.sha256 else {})


_ALLOWED_INPUT = (
    "open, black, an albedo from 0 to 1, a mapping of wavelength_nm and albedo, "
    "the name of a soil or a .csv file"
)


@cache
def load_soils() -> dict[str, Ground]:
    """Return the soils by name, with their measured directional reflectance at 10 degrees."""
    file = Path(__file__).with_name("soils.csv")
    table, lines = read_numeric_csv("soils", file), file.read_text(encoding="utf-8").splitlines()
    source = " ".join(line.lstrip("# ") for line in lines if line.startswith("#"))
    w = table["wavelength_nm"].to_numpy(dtype=float)
    return {
        name.partition("_")[0]: Ground(name, source, table[name].to_numpy(dtype=float), w)
        for name in table.columns.drop("wavelength_nm")
    }


def check_ground_reached(
    ground: Ground | None, is_semi_infinite: bool, above: str = "an infinite depth"
) -> None:
    """Check that a medium over a ground has a finite depth."""
    if ground is not None and is_semi_infinite:
        hint = f"no light reaches it below {above}: give depth_m"
        raise invalid("ground", ground.name, "left out", hint)


GroundInput = Annotated[
    Any,
    Quantity(
        "ground below", scale=0.16, check=lambda _, value: Ground.from_input(value),
        schema={
            "anyOf": [
                {"type": "number", "minimum": 0.0, "maximum": 1.0}, {"type": "string"},
                {"type": "object"}, {"type": "null"},
            ]
        },
    ),
]  # fmt: skip
