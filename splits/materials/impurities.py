"""What dirt in snow absorbs: soot, dust, ash and algae, by how much of each there is.

Particles far smaller than grains, and far fewer, absorb along the paths that light takes anyway.
That they scatter is left out; docs/how-to/impurities.md bounds it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from splits.core.arrays import check_array_range, check_increasing, read_columns
from splits.core.equality import ContentEquality
from splits.core.validation import check_range, invalid, suggest_name
from splits.materials.csv_table import read_user_table
from splits.materials.refractive_index import check_wavelength_range

ALGAE_NAMES = ("ice_algae", "snow_algae")
"""Kinds whose absorption is known per cell (m²); of the others it is per mass (m²/kg)."""
MASS_RATIO_PER_NG_G = 1e-9
"""kg of impurity per kg of ice that are 1 ng/g."""
CELLS_PER_KG_PER_CELL_ML = 1e3
"""Cells per kg of ice that are 1 per ml of its meltwater, which weighs a gram."""
MAX_NG_G = 1e8
MAX_CELLS_ML = 1e9
USER_IMPURITY_KEYS = ({"ng_g", "table"}, {"ng_g", "wavelength_nm", "absorption_m2_kg"})
USER_IMPURITY_NAME_PATTERN = re.compile(r"(?!ground$|refractive_index)[^/]{1,80}")
HALF_BAND_WIDTH_NM = 5.0
_TABLE_FILE = Path(__file__).with_suffix(".csv")


@dataclass(frozen=True, eq=False)
class Impurity(ContentEquality):
    """One kind of particles.

    Attributes
    ----------
    name : str
    amount_per_kg_ice : float
        kg, or cells of algae, per kg of ice.
    wavelength_nm, absorption : float, shape (n,)
        Absorption per kg (m²/kg) or per cell (m²) over wavelength (nm, strictly increasing).
    sha256 : str
        Of a user's file.
    is_user_defined : bool
        Whether the table is a user's.
    """

    name: str
    amount_per_kg_ice: float
    wavelength_nm: np.ndarray
    absorption: np.ndarray
    sha256: str = ""
    is_user_defined: bool = False

    def compute_absorption_per_kg_ice(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the absorption per mass of ice (m²/kg), shaped like the wavelengths (nm)."""
        first, last = self.wavelength_nm[[0, -1]]
        w = check_wavelength_range(wavelength_nm, first, last, f"impurity {self.name}")
        return self.amount_per_kg_ice * np.interp(w, self.wavelength_nm, self.absorption)


@cache
def _load_known_impurities() -> pd.DataFrame:
    return pd.read_csv(_TABLE_FILE, comment="#", index_col="wavelength_nm", dtype=float)


def list_impurities() -> tuple[str, ...]:
    """Return the kinds known by name whose amount is a mass."""
    return tuple(name for name in _load_known_impurities().columns if name not in ALGAE_NAMES)


def make_impurities(mass_ng_g: Any, cells_ml: Any) -> tuple[Impurity, ...]:
    """Return the impurities that a user's values stand for, or refuse them.

    Parameters
    ----------
    mass_ng_g : mapping
        ng of impurity per g of ice by kind, see `list_impurities`; or, under a name of one's own, a mapping
        of ``ng_g`` and either ``table``, the path of a CSV file with columns ``wavelength_nm,
        absorption_m2_kg``, or these two as lists.
    cells_ml : mapping
        Cells per ml of meltwater by kind of algae, see `ALGAE_NAMES`.

    Raises
    ------
    ValueError
        For an unknown kind, a negative amount or a malformed table.
    """
    for key, given in (("impurities_ng_g", mass_ng_g), ("algae_cells_ml", cells_ml)):
        if not isinstance(given, Mapping):
            raise invalid(key, given, "a mapping of amounts by kind")
    found = [_make_mass_impurity(name, amount) for name, amount in mass_ng_g.items()]
    for name, amount in cells_ml.items():
        number = check_range(f"algae_cells_ml.{name}", amount, 0.0, MAX_CELLS_ML, "cells/ml")
        found.append(
            _make_tabulated_impurity(
                "algae_cells_ml", name, CELLS_PER_KG_PER_CELL_ML * number, ALGAE_NAMES
            )
        )
    return tuple(found)


def describe_impurities(impurities: Sequence[Impurity], location: str) -> dict[str, Any]:
    """Return impurities under names fit for dataset attributes."""
    facts: dict[str, Any] = {"impurities_in": location} if impurities else {}
    for one in impurities:
        if one.name in ALGAE_NAMES:
            facts[f"{one.name}_cells_ml"] = one.amount_per_kg_ice / CELLS_PER_KG_PER_CELL_ML
        else:
            facts[f"{one.name}_ng_g"] = one.amount_per_kg_ice / MASS_RATIO_PER_NG_G
        if one.sha256:
            facts[f"{one.name}_sha256"] = one.sha256
        elif one.is_user_defined:
            facts[f"{one.name}_wavelength_nm"] = one.wavelength_nm
            facts[f"{one.name}_absorption_m2_kg"] = one.absorption
    return facts


def _make_mass_impurity(name: Any, value: Any) -> Impurity:
    key = f"impurities_ng_g.{name}"
    own = isinstance(value, Mapping)
    if own and set(value) not in USER_IMPURITY_KEYS:
        allowed = "ng_g and table, or ng_g, wavelength_nm and absorption_m2_kg"
        raise invalid(key, sorted(map(str, value)), allowed)
    amount = check_range(
        f"{key}.ng_g" if own else key, value["ng_g"] if own else value, 0.0, MAX_NG_G
    )
    if not own:
        return _make_tabulated_impurity(
            "impurities_ng_g", name, MASS_RATIO_PER_NG_G * amount, list_impurities()
        )
    if name in _load_known_impurities().columns:
        raise invalid("impurities_ng_g", name, "a name of its own for a table of one's own")
    if not (USER_IMPURITY_NAME_PATTERN.fullmatch(str(name)) and str(name).isprintable()):
        allowed = "a name of at most 80 characters without /, not ground or refractive_index"
        raise invalid("impurities_ng_g", name, allowed, "it names attributes of datasets")
    digest = ""
    if "table" in value:
        names = ("wavelength_nm", "absorption_m2_kg")
        (w, values), digest = read_user_table(f"{key}.table", value["table"], names)
    else:
        w, values = value["wavelength_nm"], value["absorption_m2_kg"]
    w, values = read_columns(key, {"wavelength_nm": w, "absorption_m2_kg": values})
    check_increasing(f"{key}.wavelength_nm", w)
    if w.size != values.size or w.size < 2:
        found = f"{w.size} wavelengths, {values.size} values"
        raise invalid(key, found, "two columns of the same length, at least 2")
    values = check_array_range(f"{key}.absorption_m2_kg", values, 0.0, np.inf, "m2/kg")
    return Impurity(str(name), MASS_RATIO_PER_NG_G * amount, w, values, digest, own)


def _make_tabulated_impurity(
    key: str, name: Any, amount_per_kg_ice: float, known_names: tuple[str, ...]
) -> Impurity:
    if name not in known_names:
        hint = suggest_name(name, list(known_names))
        if name in _load_known_impurities().columns:
            right = "algae_cells_ml" if name in ALGAE_NAMES else "impurities_ng_g"
            hint = f"its amount stands under {right}"
        raise invalid(key, name, "one of " + ", ".join(known_names), hint)
    column = _load_known_impurities()[name]
    w = column.index.to_numpy()
    # The first and the last band reach half a band farther than their middles.
    w = np.concatenate([[w[0] - HALF_BAND_WIDTH_NM], w, [w[-1] + HALF_BAND_WIDTH_NM]])
    return Impurity(name, amount_per_kg_ice, w, np.pad(column.to_numpy(), 1, mode="edge"))
