"""What lies below a sample: nothing, or a ground that sends light back by Lambert's law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from splits.arrays import check_each, increasing, read_columns
from splits.checks import in_range, number, refuse, suggestion
from splits.equality import ByContent
from splits.materials.kinds import within
from splits.materials.tables import columns_of, user_table
from splits.media.words import word

OPEN = "open"
BLACK = "black"
TABLE = "table"
"""Name of a table given as numbers."""
BLACK_DEPTH = 1e4
"""Optical depth of a bounce where nothing comes back: single precision holds no such light."""
_SOILS = Path(__file__).with_name("soils.csv")


@dataclass(frozen=True, eq=False, repr=False)
class Ground(ByContent):
    """A Lambertian ground by its albedo, the same at all wavelengths or a table.

    Attributes
    ----------
    name, source : str
        What it is called, and where its values are from.
    values : float, shape (n,)
        Albedo, 0 to 1.
    wavelength_nm : float, shape (n,) or None
        Strictly increasing (nm); None where the albedo is the same everywhere, and n is 1.
    sha256 : str
        Of a user's file.
    """

    name: str
    source: str
    albedo_values: np.ndarray
    wavelength_nm: np.ndarray | None = None
    sha256: str = ""

    @staticmethod
    def from_input(value: Any) -> Ground | None:
        """Return the ground that a user's value stands for, None where light leaves below.

        Parameters
        ----------
        given : None, str, number, mapping, path or Ground
            ``"open"`` or None; ``"black"``; an albedo; a mapping of ``wavelength_nm`` and
            ``albedo``, lists; the name of a soil, see `soils`; or the path of a CSV file with
            columns ``wavelength_nm, albedo``.

        Raises
        ------
        ValueError
            For an unknown name, a malformed table or an albedo outside 0 to 1.
        """
        if value is None or isinstance(value, Ground):
            return value
        value = columns_of(value)
        if isinstance(value, Path) or (isinstance(value, str) and value.endswith(".csv")):
            return _from_file(Path(value))
        if isinstance(value, str):
            return _named(value)
        if isinstance(value, Mapping):
            if set(value) != {"wavelength_nm", "albedo"}:
                keys = sorted(map(str, value))
                raise refuse("ground", keys, "a mapping of wavelength_nm and albedo, lists")
            return _table(TABLE, "given by the user", value["wavelength_nm"], value["albedo"])
        albedo = in_range("ground", number("ground", value, _ALLOWED), 0.0, 1.0)
        return Ground(f"albedo {albedo!r}", "given by the user", np.array([albedo]))

    def as_input(self) -> Any:
        """Return what a user gives for this ground, see `of`; of a file, its name."""
        if self.name == TABLE:
            return {"wavelength_nm": self.wavelength_nm, "albedo": self.albedo_values}
        if self.wavelength_nm is None:
            return BLACK if self.name == BLACK else float(self.albedo_values[0])
        return self.name if self.sha256 else _soil(self.name)

    def __repr__(self) -> str:
        """Return the ground on one line."""
        return f"Ground.of({word(self)})"

    @property
    def is_reflecting(self) -> bool:
        """Whether light comes back at any wavelength."""
        return bool((self.albedo_values > 0.0).any())

    def albedo(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the albedo at wavelengths (nm), shaped like them; linear between table rows."""
        if self.wavelength_nm is None:
            return np.full(np.shape(wavelength_nm), self.albedo_values[0])
        first, last = self.wavelength_nm[[0, -1]]
        return np.interp(
            within(wavelength_nm, first, last, f"ground {self.name}"),
            self.wavelength_nm,
            self.albedo_values,
        )

    def optical_depth(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the optical depth of a bounce, −ln of the albedo, shaped like the wavelengths."""
        albedo = self.albedo(wavelength_nm)
        dark = albedo <= np.exp(-BLACK_DEPTH)
        return np.where(dark, BLACK_DEPTH, -np.log(np.where(dark, 1.0, albedo)))


def ground_facts(ground: Ground | None) -> dict[str, Any]:
    """Return what a ground is, for a dataset's attributes."""
    if ground is None:
        return {"ground": OPEN}
    facts: dict[str, Any] = {"ground": ground.name}
    if ground.name == TABLE:
        facts |= {"ground_wavelength_nm": ground.wavelength_nm, "ground_albedo": ground.albedo_values}
    return facts | ({"ground_sha256": ground.sha256} if ground.sha256 else {})


_ALLOWED = (
    "open, black, an albedo from 0 to 1, a mapping of wavelength_nm and albedo, "
    "the name of a soil or a .csv file"
)


@cache
def soils() -> dict[str, Ground]:
    """Return the soils known by name, with their measured directional reflectance at 10 degrees."""
    table = pd.read_csv(_SOILS, comment="#")
    lines = _SOILS.read_text(encoding="utf-8").splitlines()
    source = " ".join(line.lstrip("# ") for line in lines if line.startswith("#"))
    w = table["wavelength_nm"].to_numpy(dtype=float)
    columns = [name for name in table.columns if name != "wavelength_nm"]
    return {
        _soil(name): Ground(name, source, table[name].to_numpy(dtype=float), w) for name in columns
    }


def _soil(name: str) -> str:
    """Return what users call the soil of a column."""
    return name.partition("_")[0]


def _named(name: str) -> Ground | None:
    if name == OPEN:
        return None
    if name == BLACK:
        return Ground(BLACK, "given by the user", np.zeros(1))
    known = soils()
    if name not in known:
        hint = suggestion(name, [OPEN, BLACK, *known]) or "soils: " + ", ".join(known)
        raise refuse("ground", name, _ALLOWED, hint)
    return known[name]


def _table(name: str, source: str, wavelength_nm: Any, albedo: Any, sha256: str = "") -> Ground:
    """Return a ground by its table, or refuse that."""
    given = {"wavelength_nm": wavelength_nm, "albedo": albedo}
    w, values = read_columns("ground", given)
    increasing("ground.wavelength_nm", w)
    if w.size != values.size or w.size < 2:
        allowed = "two lists of the same length, at least 2"
        raise refuse("ground", f"{w.size} wavelengths, {values.size} albedos", allowed)
    values = check_each("ground.albedo", values, 0.0, 1.0)
    return Ground(name, source, values, w, sha256)


def _from_file(path: Path) -> Ground:
    """Return a ground by a file's table, or refuse that."""
    (w, albedo), digest = user_table("ground", path, ("wavelength_nm", "albedo"))
    return _table(path.name, "table of the user", w, albedo, digest)
