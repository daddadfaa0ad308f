"""Absorption by light-absorbing impurities in snow: black carbon, dust, ash and algae.

The particles are much smaller and much rarer than grains, so they absorb along paths that they do
not change.  Their scattering is neglected; docs/how-to/impurities.md gives a bound on its effect.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from splits.core.arrays import ContentEquality, check_array_range
from splits.core.declarations import Quantity
from splits.core.inputs import check_mapping
from splits.core.validation import check_range, check_relations, invalid, suggest_name
from splits.materials.csv_table import read_numeric_csv, read_tabulated_function
from splits.materials.refractive_index import check_wavelength_range

ALGAE_NAMES = ("snow_algae", "ice_algae")
"""Types with absorption per cell (m²); that of other types is per mass (m²/kg)."""
MASS_RATIO_PER_NG_G = 1e-9
"""Mass of impurity per mass of ice of 1 ng/g."""
CELLS_PER_KG_PER_CELL_ML = 1e3
"""Cells per kg of ice of 1 cell per ml of meltwater, with 1 g of meltwater per ml."""
MAX_NG_G = 1e8
MAX_CELLS_ML = 1e9
USER_IMPURITY_NAME_PATTERN = re.compile(r"(?!ground$|refractive_index)[^/]{1,80}")
HALF_BAND_WIDTH_NM = 5.0

Impurities = Annotated[
    Mapping[str, Any],
    Quantity(
        "mass of impurities per mass of ice", "1e-9",
        check=check_mapping("a mapping of amounts by kind, such as {'black_carbon': 100}"),
        schema={"type": "object"}, label="impurities", kinds=lambda: list_impurities(),
        scale=1.0,
    ),
]  # fmt: skip
AlgaeCells = Annotated[
    Mapping[str, float],
    Quantity(
        "number of algae cells per volume of meltwater", "ml-1",
        check=check_mapping("a mapping of amounts by kind, such as {'snow_algae': 100}"),
        schema={"type": "object", "additionalProperties": {"type": "number"}},
        label="algae", kinds=lambda: ALGAE_NAMES, scale=1000.0,
    ),
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Impurity(ContentEquality):
    """Impurity of one type.

    Attributes
    ----------
    name : str
    amount_per_kg_ice : float
        Mass (kg), or number of algae cells, per kg of ice.
    wavelength_nm, absorption : float, shape (n,)
        Wavelengths (nm, strictly increasing) and absorption cross-section per kg (m²/kg) or per
        cell (m²).
    sha256 : str
        SHA-256 of a user's file, otherwise empty.
    is_user_defined : bool
        Whether the table was given by the user.
    """

    name: str
    amount_per_kg_ice: float
    wavelength_nm: np.ndarray
    absorption: np.ndarray
    sha256: str = ""
    is_user_defined: bool = False

    def compute_absorption_per_kg_ice(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the absorption cross-section per mass of ice (m²/kg) at wavelengths (nm)."""
        first, last = self.wavelength_nm[[0, -1]]
        w = check_wavelength_range(wavelength_nm, first, last, f"impurity {self.name}")
        return self.amount_per_kg_ice * np.interp(w, self.wavelength_nm, self.absorption)


@cache
def _load_known_impurities() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the wavelengths (nm) and the absorption of the tabulated impurities by name."""
    file = Path(__file__).with_suffix(".csv")
    table = read_numeric_csv("impurities", file).set_index("wavelength_nm")
    w = table.index.to_numpy()
    # The outermost bands extend half a band width past their centres.
    w = np.concatenate([[w[0] - HALF_BAND_WIDTH_NM], w, [w[-1] + HALF_BAND_WIDTH_NM]])
    return {str(name): (w, np.pad(table[name].to_numpy(), 1, mode="edge")) for name in table}


def list_impurities() -> tuple[str, ...]:
    """Return the names of the tabulated impurities whose amount is a mass."""
    return tuple(name for name in _load_known_impurities() if name not in ALGAE_NAMES)


def make_impurities(
    mass_ng_g: Mapping[str, Any], cells_ml: Mapping[str, float]
) -> tuple[Impurity, ...]:
    """Return the impurities for a user's input.

    Parameters
    ----------
    mass_ng_g : mapping
        Mass of impurity per mass of ice (ng/g) by type, see `list_impurities`.  Under any other
        name, a mapping of ``ng_g`` and either ``table``, the path of a CSV file with columns
        ``wavelength_nm, absorption_m2_kg``, or these two columns as lists.
    cells_ml : mapping
        Cells per ml of meltwater by type of algae, see `ALGAE_NAMES`.

    Raises
    ------
    ValueError
        For an unknown type, a negative amount or a malformed table.
    """
    impurities = [_make_mass_impurity(name, amount) for name, amount in mass_ng_g.items()]
    for name, amount in cells_ml.items():
        number = check_range(f"algae_cells_ml.{name}", amount, 0.0, MAX_CELLS_ML, "cells/ml")
        impurities.append(
            _make_tabulated_impurity(
                "algae_cells_ml", name, CELLS_PER_KG_PER_CELL_ML * number, ALGAE_NAMES
            )
        )
    return tuple(impurities)


def describe_impurities(impurities: Sequence[Impurity], location: str) -> dict[str, Any]:
    """Return impurities as dataset attributes."""
    attrs: dict[str, Any] = {"impurities_in": location} if impurities else {}
    for impurity in impurities:
        if impurity.name in ALGAE_NAMES:
            attrs[f"{impurity.name}_cells_ml"] = (
                impurity.amount_per_kg_ice / CELLS_PER_KG_PER_CELL_ML
            )
        else:
            attrs[f"{impurity.name}_ng_g"] = impurity.amount_per_kg_ice / MASS_RATIO_PER_NG_G
        if impurity.sha256:
            attrs[f"{impurity.name}_sha256"] = impurity.sha256
        elif impurity.is_user_defined:
            attrs[f"{impurity.name}_wavelength_nm"] = impurity.wavelength_nm
            attrs[f"{impurity.name}_absorption_m2_kg"] = impurity.absorption
    return attrs


def _make_mass_impurity(name: Any, value: Any) -> Impurity:
    key = f"impurities_ng_g.{name}"
    if not isinstance(value, Mapping):
        amount = MASS_RATIO_PER_NG_G * check_range(key, value, 0.0, MAX_NG_G)
        return _make_tabulated_impurity("impurities_ng_g", name, amount, list_impurities())
    if set(value) not in ({"ng_g", "table"}, {"ng_g", "wavelength_nm", "absorption_m2_kg"}):
        allowed = "ng_g and table, or ng_g, wavelength_nm and absorption_m2_kg"
        raise invalid(key, sorted(map(str, value)), allowed)
    amount = MASS_RATIO_PER_NG_G * check_range(f"{key}.ng_g", value["ng_g"], 0.0, MAX_NG_G)
    is_name = USER_IMPURITY_NAME_PATTERN.fullmatch(str(name)) and str(name).isprintable()
    is_known, keyword = name in _load_known_impurities(), "impurities_ng_g"
    check_relations(
        (not is_known, keyword, name, "a new name for a user table"),
        (
            is_name, keyword, name,
            "a name of at most 80 characters without /, not ground or refractive_index",
            "it names attributes of datasets",
        ),
    )  # fmt: skip
    columns = {name: given for name, given in value.items() if name != "ng_g"}
    table_key, table = (f"{key}.table", value["table"]) if "table" in value else (key, columns)
    names = ("wavelength_nm", "absorption_m2_kg")
    (w, values), digest = read_tabulated_function(table_key, table, names)
    values = check_array_range(f"{key}.absorption_m2_kg", values, 0.0, np.inf, "m2/kg")
    return Impurity(str(name), amount, w, values, digest, is_user_defined=True)


def _make_tabulated_impurity(
    key: str, name: Any, amount_per_kg_ice: float, known_names: tuple[str, ...]
) -> Impurity:
    if name not in known_names:
        hint = suggest_name(name, list(known_names))
        if name in _load_known_impurities():
            keyword = "algae_cells_ml" if name in ALGAE_NAMES else "impurities_ng_g"
            hint = f"its amount belongs to {keyword}"
        raise invalid(key, name, "one of " + ", ".join(known_names), hint)
    return Impurity(name, amount_per_kg_ice, *_load_known_impurities()[name])
