"""Named datasets of refractive indices, per material, and how they are read.

The tables lie in the folder ``indices``, each with its citation in its first line and its licence
in the second.  Nothing is fetched.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from splits.checks import one_of
from splits.materials.kinds import Constant, RefractiveIndex, Sellmeier, Tabulated
from splits.materials.oscillators import goethite

_FOLDER = Path(__file__).parent / "indices"
_GHOSH = (
    "G. Ghosh. Dispersion-equation coefficients for the refractive index and birefringence of "
    "calcite and quartz crystals. Opt. Commun. 163, 95-102 (1999)"
)
_GHOSH_NM = (198.0, 2053.1)


def _columns(file: str) -> tuple[np.ndarray, str]:
    """Return the columns of a table, and the reference in its first line."""
    lines = (_FOLDER / f"{file}.csv").read_text(encoding="utf-8").splitlines()
    rows = [line for line in lines if not line.startswith("#")]
    return np.loadtxt(rows[1:], delimiter=",").T, lines[0].removeprefix("# ")


def _table(material: str, name: str) -> Tabulated:
    (w_um, n, k), source = _columns(f"{material}_{name}")
    return Tabulated(name, source, *_orderly(w_um * 1e3, n, k))


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


def _ice_warren_2008() -> Tabulated:
    return _table("ice", "warren_brandt_2008")


def _ice_picard_2016() -> Tabulated:
    """Warren & Brandt 2008 with the absorption of Picard et al. 2016 below 600 nm.

    Picard's table begins at 320 nm; from 200 nm to there its first value is held, for the last
    half per cent of sunlight.
    """
    warren = _ice_warren_2008()
    (short, absorption), reference = _columns("ice_picard_2016")
    short, absorption = short[short < 600.0], absorption[short < 600.0]
    beyond = np.arange(200.0, short[0], 10.0)
    short = np.concatenate([beyond, short])
    absorption = np.concatenate([np.full(beyond.size, absorption[0]), absorption])
    k_short = absorption * short * 1e-9 / (4.0 * np.pi)
    keep = warren.wavelength_nm >= 600.0
    w = np.concatenate([short, warren.wavelength_nm[keep]])
    n = np.concatenate([warren(short).real, warren.n[keep]])
    k = np.concatenate([k_short, warren.k[keep]])
    source = (
        f"k below 600 nm, constant absorption below 320 nm: {reference}; elsewhere: {warren.source}"
    )
    return Tabulated("warren_brandt_2008_picard_2016", source, w, n, k)


def _water_hale() -> Tabulated:
    return _table("water", "hale_querry_1973")


def _water_segelstein() -> Tabulated:
    return _table("water", "segelstein_1981")


def _quartz_ordinary() -> Sellmeier:
    terms = (1.07044083, 1.00585997e-2), (1.10202242, 100.0)
    return Sellmeier("ghosh_1999_ordinary", _GHOSH, _GHOSH_NM, 0.28604141, terms)


def _quartz_extraordinary() -> Sellmeier:
    terms = (1.09509924, 1.02101864e-2), (1.15662475, 100.0)
    return Sellmeier("ghosh_1999_extraordinary", _GHOSH, _GHOSH_NM, 0.28851804, terms)


def _hematite_ordinary() -> Tabulated:
    return _table("hematite", "querry_1985_ordinary")


def _hematite_extraordinary() -> Tabulated:
    return _table("hematite", "querry_1985_extraordinary")


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
    return _table("magnetite", "querry_1985")


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
