"""Named datasets of refractive indices by material.

The tables are in the folder ``indices``; the first line of each holds its citation and the second
its licence.  Nothing is downloaded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from splits.core.arrays import read_columns
from splits.core.validation import (
    as_scalar,
    check_choice,
    check_number,
    check_range,
    invalid,
    join_names,
    suggest_name,
)
from splits.materials.csv_table import is_csv_path, read_user_table, to_columns
from splits.materials.refractive_index import (
    ConstantIndex,
    RefractiveIndex,
    ScaledIndex,
    SellmeierIndex,
    TabulatedIndex,
    make_goethite,
)

# --------------------------------------------------------------------------------------------------
# Densities of ice and minerals.

_ICE_TEMPERATURE_C = np.array([-40.0, -30.0, -20.0, -10.0, 0.0])
_ICE_DENSITY_KG_M3 = np.array([922.8, 921.6, 920.3, 918.7, 916.7])

MINERAL_DENSITY_KG_M3: Mapping[str, float] = MappingProxyType(
    {
        "quartz": 2650.0,
        "hematite": 5250.0,
        "goethite": 4300.0,
        "magnetite": 5200.0,
        "kaolinite": 2590.0,
    }
)
"""Densities of minerals (kg/m³), SPLITS (Kimmel & Baranoski 2007) Table 2."""


def ice_density(temperature_c: float) -> float:
    """Return the density of ice (kg/m³), linear between tabulated temperatures.

    Parameters
    ----------
    temperature_c : float
        Temperature (°C), −40 to 0.

    Raises
    ------
    ValueError
        For a temperature outside the table.

    References
    ----------
    CRC Handbook of Chemistry and Physics (Rumble 2019), as used in SPLITSnow appendix A.
    """
    temperature_c = check_range("temperature_c", temperature_c, -40.0, 0.0, "degrees Celsius")
    return float(interpolate_ice_density(temperature_c))


def interpolate_ice_density(temperature_c: np.ndarray | float) -> np.ndarray:
    """Return the density of ice (kg/m³) at temperatures (°C), those of `ice_density`, unchecked.

    Beyond −40 and 0 °C it is that of the nearer limit; NaN gives NaN.
    """
    return np.asarray(np.interp(temperature_c, _ICE_TEMPERATURE_C, _ICE_DENSITY_KG_M3))


# --------------------------------------------------------------------------------------------------
# Named datasets of refractive indices by material.

_INDEX_FOLDER = Path(__file__).parent / "indices"
_GHOSH_REFERENCE = (
    "G. Ghosh. Dispersion-equation coefficients for the refractive index and birefringence of "
    "calcite and quartz crystals. Opt. Commun. 163, 95-102 (1999)"
)


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


def _load_ice_picard_2016() -> TabulatedIndex:
    """Return Warren & Brandt 2008 with the absorption of Picard et al. 2016 below 600 nm.

    Picard's table begins at 320 nm.  Its first value is used from 200 to 320 nm, a range of about
    0.5 % of sunlight.
    """
    warren = _load_table("ice", "warren_brandt_2008")
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


def _make_quartz(axis: str, constant: float, *terms: tuple[float, float]) -> SellmeierIndex:
    return SellmeierIndex(f"ghosh_1999_{axis}", _GHOSH_REFERENCE, (198.0, 2053.1), constant, terms)


def _make_hematite_mean() -> TabulatedIndex:
    """Return the index of randomly oriented crystals, √((2 ε_o + ε_e)/3), in the common range."""
    ordinary = _load_table("hematite", "querry_1985_ordinary")
    extraordinary = _load_table("hematite", "querry_1985_extraordinary")
    tables = (ordinary.wavelength_nm, extraordinary.wavelength_nm)
    w = np.union1d(*tables)
    w = w[(w >= max(t[0] for t in tables)) & (w <= min(t[-1] for t in tables))]
    index = np.sqrt((2.0 * ordinary(w) ** 2 + extraordinary(w) ** 2) / 3.0)
    source = "mean dielectric constant (2 ordinary + extraordinary)/3 of " + ordinary.source
    return TabulatedIndex("querry_1985", source, w, index.real, index.imag)


_DATASET_LOADERS: dict[str, dict[str, Callable[[], RefractiveIndex]]] = {
    "ice": {
        "warren_brandt_2008": partial(_load_table, "ice", "warren_brandt_2008"),
        "warren_brandt_2008_picard_2016": _load_ice_picard_2016,
    },
    "water": {
        "hale_querry_1973": partial(_load_table, "water", "hale_querry_1973"),
        "segelstein_1981": partial(_load_table, "water", "segelstein_1981"),
    },
    "quartz": {
        "ghosh_1999_ordinary": partial(
            _make_quartz, "ordinary", 0.28604141, (1.07044083, 1.00585997e-2), (1.10202242, 100.0)
        ),
        "ghosh_1999_extraordinary": partial(
            _make_quartz,
            "extraordinary",
            0.28851804,
            (1.09509924, 1.02101864e-2),
            (1.15662475, 100.0),
        ),
    },
    "hematite": {
        "querry_1985": _make_hematite_mean,
        "querry_1985_ordinary": partial(_load_table, "hematite", "querry_1985_ordinary"),
        "querry_1985_extraordinary": partial(_load_table, "hematite", "querry_1985_extraordinary"),
    },
    "goethite": {"oscillators": make_goethite},
    "magnetite": {"querry_1985": partial(_load_table, "magnetite", "querry_1985")},
    "kaolinite": {
        # No public table was found for the visible.
        "egan_hilgeman_1979": partial(
            ConstantIndex,
            1.56 + 5e-4j,
            "egan_hilgeman_1979 (constant)",
            "a constant, the same at every wavelength: n and the order of magnitude of k near "
            "620 nm after W. G. Egan, T. W. Hilgeman. Optical Properties of Inhomogeneous "
            "Materials, Academic Press (1979)",
        ),
    },
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


# --------------------------------------------------------------------------------------------------
# Complex refractive index n + i k from a user's input: named dataset, constant or table.


def make_refractive_index(material: str, spec: Any = None) -> RefractiveIndex:
    """Return the refractive index for a user's input.

    Parameters
    ----------
    material : str
        ``"ice"``, ``"water"``, ``"quartz"``, ``"hematite"``, ``"goethite"``, ``"magnetite"`` or
        ``"kaolinite"``; determines the names of datasets.
    spec : None, str, number, mapping, path or RefractiveIndex
        None selects the default dataset of the material.  A string is the name of a dataset, a
        complex number such as ``"1.31+1e-7j"``, or the path of a CSV file with columns
        ``wavelength_nm, n, k``.  A mapping holds ``n`` and ``k``, as numbers or, with
        ``wavelength_nm``, as lists; or ``dataset`` (a name; the default dataset if omitted) and
        ``k_factor`` (above 0), which multiplies k and leaves n unchanged.

    Raises
    ------
    ValueError
        For an unknown name, a malformed table, an invalid index or an invalid factor.

    Examples
    --------
    >>> make_refractive_index("goethite", {"k_factor": 0.5}).name
    'oscillators, k x 0.5'
    """
    names = list_datasets(material)
    if spec is None:
        return load_dataset(material, names[0])
    if not isinstance(spec, Mapping) or {"dataset", "k_factor"}.isdisjoint(spec):
        return parse_refractive_index(material, spec, names)
    key = f"refractive_index[{material}]"
    if set(spec) - {"dataset", "k_factor"}:
        raise invalid(key, dict(spec), "a mapping of dataset and k_factor only")
    dataset = check_choice(f"{key}.dataset", spec.get("dataset", names[0]), names)
    index = load_dataset(material, dataset)
    if "k_factor" not in spec:
        return index
    factor = check_range(f"{key}.k_factor", spec["k_factor"], 0.0, np.inf, open_low=True)
    return ScaledIndex(index, factor)


def parse_refractive_index(
    material: str, spec: Any, dataset_names: Sequence[str] = ()
) -> RefractiveIndex:
    """Return the refractive index for an input other than None; see `make_refractive_index`."""
    key, spec = f"refractive_index[{material}]", to_columns(spec)
    if isinstance(spec, str):
        if spec in dataset_names:
            return load_dataset(material, spec)
        if not is_csv_path(spec):
            try:
                number = complex(spec.replace(" ", ""))
            except ValueError:
                names = sorted([*dataset_names, "a complex number", "a .csv file"])
                allowed = f"one of {join_names(names)}"
                raise invalid(key, spec, allowed, suggest_name(spec, names)) from None
            return ConstantIndex(number)
    if isinstance(spec, str | Path):
        (w, n, k), digest = read_user_table(key, spec, ("wavelength_nm", "n", "k"))
        return TabulatedIndex(Path(spec).name, "table of the user", w, n, k, digest)
    if isinstance(spec, Mapping):
        if set(spec) - {"wavelength_nm", "n", "k"} or "n" not in spec:
            allowed = (
                "a mapping of n, k and, for a table, wavelength_nm, or of dataset and k_factor"
            )
            raise invalid(key, dict(spec), allowed)
        columns = {name: spec.get(name, 0.0) for name in ("wavelength_nm", "n", "k")}
        if "wavelength_nm" not in spec:
            parts = (check_number(f"{key}.{name}", columns[name]) for name in ("n", "k"))
            return ConstantIndex(complex(*parts))
        w, n, k = read_columns(key, columns)
        k = np.broadcast_to(k, w.shape) if k.size == 1 else k
        return TabulatedIndex(f"user table for {material}", "given by the user", w, n, k)
    spec = as_scalar(spec)
    if isinstance(spec, (int, float, complex)) and not isinstance(spec, bool):
        return ConstantIndex(
            spec if isinstance(spec, complex) else complex(check_number(key, spec))
        )
    if callable(spec) and hasattr(spec, "name"):
        return spec
    raise invalid(key, spec, "a dataset name, a complex constant, a table or a CSV file")


def absorption_coefficient(index: np.ndarray, wavelength_nm: np.ndarray) -> np.ndarray:
    """Return the absorption coefficient α = 4πk/λ (1/m), SPLITSnow Eq 6; wavelengths in nm."""
    return 4.0 * np.pi * index.imag / (np.asarray(wavelength_nm, dtype=float) * 1e-9)
