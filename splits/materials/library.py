"""Named datasets of refractive indices by material.

The tables are in the folder ``indices``; the first line of each holds its citation and the second
its licence.  Nothing is downloaded.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from splits.core.validation import check_choice
from splits.materials.lorentz import make_goethite
from splits.materials.refractive_index import (
    ConstantIndex,
    RefractiveIndex,
    ScaledIndex,
    SellmeierIndex,
    TabulatedIndex,
)

_INDEX_FOLDER = Path(__file__).parent / "indices"
_GHOSH_REFERENCE = (
    "G. Ghosh. Dispersion-equation coefficients for the refractive index and birefringence of "
    "calcite and quartz crystals. Opt. Commun. 163, 95-102 (1999)"
)
_GHOSH_RANGE_NM = (198.0, 2053.1)


def _load_columns(file: str) -> tuple[np.ndarray, str]:
    """Return the columns of a table and the citation in its first line."""
    lines = (_INDEX_FOLDER / f"{file}.csv").read_text(encoding="utf-8").splitlines()
    rows = [line for line in lines if not line.startswith("#")]
    return np.loadtxt(rows[1:], delimiter=",").T, lines[0].removeprefix("# ")


def _load_table(material: str, name: str) -> TabulatedIndex:
    (w_um, n, k), source = _load_columns(f"{material}_{name}")
    return TabulatedIndex(name, source, *_drop_invalid_rows(w_um * 1e3, n, k))


def _drop_invalid_rows(
    w: np.ndarray, n: np.ndarray, k: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a table without invalid rows.

    Querry's tables repeat or misprint a few wavelengths above 1.9 µm (3.6911 for 3.8911 µm), so a
    row is valid if its wavelength exceeds all before it.  The table ends where his Kramers-Kronig
    analysis gives negative k (far infrared).
    """
    increasing = np.concatenate([[True], w[1:] > np.maximum.accumulate(w)[:-1]])
    keep = increasing & (np.cumsum(k < 0.0) == 0)
    return w[keep], n[keep], k[keep]


def _load_ice_warren_2008() -> TabulatedIndex:
    return _load_table("ice", "warren_brandt_2008")


def _load_ice_picard_2016() -> TabulatedIndex:
    """Return Warren & Brandt 2008 with the absorption of Picard et al. 2016 below 600 nm.

    Picard's table begins at 320 nm.  Its first value is used from 200 to 320 nm, a range of about
    0.5 % of sunlight.
    """
    warren = _load_ice_warren_2008()
    (short, absorption), reference = _load_columns("ice_picard_2016")
    short, absorption = short[short < 600.0], absorption[short < 600.0]
    extrapolated = np.arange(200.0, short[0], 10.0)
    short = np.concatenate([extrapolated, short])
    absorption = np.concatenate([np.full(extrapolated.size, absorption[0]), absorption])
    k_short = absorption * short * 1e-9 / (4.0 * np.pi)
    keep = warren.wavelength_nm >= 600.0
    w = np.concatenate([short, warren.wavelength_nm[keep]])
    n = np.concatenate([warren(short).real, warren.n[keep]])
    k = np.concatenate([k_short, warren.k[keep]])
    source = (
        f"k below 600 nm, constant absorption below 320 nm: {reference}; elsewhere: {warren.source}"
    )
    return TabulatedIndex("warren_brandt_2008_picard_2016", source, w, n, k)


def _load_water_hale() -> TabulatedIndex:
    return _load_table("water", "hale_querry_1973")


def _load_water_segelstein() -> TabulatedIndex:
    return _load_table("water", "segelstein_1981")


def _make_quartz_ordinary() -> SellmeierIndex:
    terms = (1.07044083, 1.00585997e-2), (1.10202242, 100.0)
    return SellmeierIndex(
        "ghosh_1999_ordinary", _GHOSH_REFERENCE, _GHOSH_RANGE_NM, 0.28604141, terms
    )


def _make_quartz_extraordinary() -> SellmeierIndex:
    terms = (1.09509924, 1.02101864e-2), (1.15662475, 100.0)
    return SellmeierIndex(
        "ghosh_1999_extraordinary", _GHOSH_REFERENCE, _GHOSH_RANGE_NM, 0.28851804, terms
    )


def _load_hematite_ordinary() -> TabulatedIndex:
    return _load_table("hematite", "querry_1985_ordinary")


def _load_hematite_extraordinary() -> TabulatedIndex:
    return _load_table("hematite", "querry_1985_extraordinary")


def _make_hematite_mean() -> TabulatedIndex:
    """Return the index of randomly oriented crystals, √((2 ε_o + ε_e)/3), in the common range."""
    ordinary, extraordinary = _load_hematite_ordinary(), _load_hematite_extraordinary()
    tables = (ordinary.wavelength_nm, extraordinary.wavelength_nm)
    w = np.union1d(*tables)
    w = w[(w >= max(t[0] for t in tables)) & (w <= min(t[-1] for t in tables))]
    index = np.sqrt((2.0 * ordinary(w) ** 2 + extraordinary(w) ** 2) / 3.0)
    source = "mean dielectric constant (2 ordinary + extraordinary)/3 of " + ordinary.source
    return TabulatedIndex("querry_1985", source, w, index.real, index.imag)


def _load_magnetite() -> TabulatedIndex:
    return _load_table("magnetite", "querry_1985")


def _make_kaolinite() -> ConstantIndex:
    """Return a constant index; no public table was found for the visible."""
    source = (
        "a constant, the same at every wavelength: n and the order of magnitude of k near 620 nm "
        "after W. G. Egan, T. W. Hilgeman. Optical Properties of Inhomogeneous Materials, "
        "Academic Press (1979)"
    )
    return ConstantIndex(1.56 + 5e-4j, "egan_hilgeman_1979 (constant)", source)


_DATASET_LOADERS: dict[str, dict[str, Callable[[], RefractiveIndex]]] = {
    "ice": {
        "warren_brandt_2008": _load_ice_warren_2008,
        "warren_brandt_2008_picard_2016": _load_ice_picard_2016,
    },
    "water": {"hale_querry_1973": _load_water_hale, "segelstein_1981": _load_water_segelstein},
    "quartz": {
        "ghosh_1999_ordinary": _make_quartz_ordinary,
        "ghosh_1999_extraordinary": _make_quartz_extraordinary,
    },
    "hematite": {
        "querry_1985": _make_hematite_mean,
        "querry_1985_ordinary": _load_hematite_ordinary,
        "querry_1985_extraordinary": _load_hematite_extraordinary,
    },
    "goethite": {"oscillators": make_goethite},
    "magnetite": {"querry_1985": _load_magnetite},
    "kaolinite": {"egan_hilgeman_1979": _make_kaolinite},
}

MATERIALS = tuple(_DATASET_LOADERS)
"""Names of the materials with datasets."""


def list_datasets(material: str) -> list[str]:
    """Return the names of the datasets of a material, the default first."""
    return list(_DATASET_LOADERS[check_choice("material", material, _DATASET_LOADERS)])


@cache
def load_dataset(material: str, name: str) -> RefractiveIndex:
    """Return the dataset `name` of a material (see `list_datasets`), cached."""
    return _DATASET_LOADERS[material][name]()


def is_dataset(material: str, index: RefractiveIndex) -> bool:
    """Return whether a refractive index is a dataset of a material, perhaps with k scaled."""
    known = index.index if isinstance(index, ScaledIndex) else index
    return any(known == load_dataset(material, name) for name in _DATASET_LOADERS[material])
