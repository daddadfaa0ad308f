"""The complex refractive index n + i k that a user's specification stands for.

Wherever an index is asked for, a named dataset can stand, a constant, or a user's table.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from splits.arrays import read_columns
from splits.checks import Refusal, in_range, number, one_of, refuse, scalar
from splits.materials.datasets import dataset, dataset_names
from splits.materials.kinds import Constant, RefractiveIndex, Scaled, Tabulated
from splits.materials.tables import columns_of, user_table


def refractive_index(material: str, spec: Any = None) -> RefractiveIndex:
    """Return the refractive index that `spec` stands for.

    Parameters
    ----------
    material : str
        ``"ice"``, ``"water"``, ``"quartz"``, ``"hematite"``, ``"goethite"``, ``"magnetite"`` or
        ``"kaolinite"``; decides which dataset names are known.
    spec : None, str, number, mapping, path or RefractiveIndex
        Nothing takes the material's default dataset.  A string is a dataset's name, a complex
        number such as ``"1.31+1e-7j"``, or the path of a CSV file with columns
        ``wavelength_nm, n, k``.  A mapping holds ``n`` and ``k``, numbers or, together with
        ``wavelength_nm``, lists; or ``dataset`` (a name; without it the default) and ``k_factor``
        (above 0), which multiplies the dataset's k and leaves its n.

    Raises
    ------
    ValueError
        For an unknown name, a malformed table, an impossible index or a bad factor.

    Examples
    --------
    >>> refractive_index("goethite", {"k_factor": 0.5}).name
    'oscillators, k x 0.5'
    """
    names = dataset_names(material)
    if spec is None:
        return dataset(material, names[0])
    if isinstance(spec, Mapping) and {"dataset", "k_factor"} & set(spec):
        return _scaled(f"refractive_index[{material}]", material, spec)
    return given_index(material, spec, names)


def given_index(material: str, spec: Any, dataset_names: Sequence[str] = ()) -> RefractiveIndex:
    """Return what `refractive_index` does of a material with datasets of these names, or none."""
    key, spec = f"refractive_index[{material}]", columns_of(spec)
    if isinstance(spec, str):
        if spec in dataset_names:
            return dataset(material, spec)
        if spec.endswith(".csv"):
            return _user_table(key, Path(spec))
        try:
            return Constant(complex(spec.replace(" ", "")))
        except Refusal:
            raise
        except ValueError:
            one_of(key, spec, [*dataset_names, "a complex number", "a .csv file"])
    if isinstance(spec, Path):
        return _user_table(key, spec)
    if isinstance(spec, Mapping):
        return _user_values(key, material, spec)
    spec = scalar(spec)
    if isinstance(spec, (int, float, complex)) and not isinstance(spec, bool):
        return Constant(spec if isinstance(spec, complex) else complex(number(key, spec)))
    if callable(spec) and hasattr(spec, "name"):
        return spec
    raise refuse(key, spec, "a dataset name, a complex constant, a table or a CSV file")


def _scaled(key: str, material: str, spec: Mapping[str, Any]) -> RefractiveIndex:
    if set(spec) - {"dataset", "k_factor"}:
        raise refuse(key, dict(spec), "a mapping of dataset and k_factor, and nothing else")
    names = dataset_names(material)
    index = dataset(material, one_of(f"{key}.dataset", spec.get("dataset", names[0]), names))
    if "k_factor" not in spec:
        return index
    factor = in_range(f"{key}.k_factor", spec["k_factor"], 0.0, np.inf, open_low=True)
    return Scaled(index, factor)


def _user_values(key: str, material: str, spec: Mapping[str, Any]) -> RefractiveIndex:
    if set(spec) - {"wavelength_nm", "n", "k"} or "n" not in spec:
        allowed = "a mapping of n, k and, for a table, wavelength_nm, or of dataset and k_factor"
        raise refuse(key, dict(spec), allowed)
    k = spec.get("k", 0.0)
    if "wavelength_nm" not in spec:
        return Constant(complex(number(f"{key}.n", spec["n"]), number(f"{key}.k", k)))
    given = {"wavelength_nm": spec["wavelength_nm"], "n": spec["n"], "k": k}
    w, n, k = read_columns(key, given)
    k = np.broadcast_to(k, w.shape) if k.size == 1 else k
    return Tabulated(f"user table for {material}", "given by the user", w, n, k)


def _user_table(key: str, path: Path) -> Tabulated:
    (w, n, k), digest = user_table(key, path, ("wavelength_nm", "n", "k"))
    return Tabulated(path.name, "table of the user", w, n, k, digest)


def absorption_coefficient(index: np.ndarray, wavelength_nm: np.ndarray) -> np.ndarray:
    """Return α = 4πk/λ in 1/m (SPLITSnow Eq 6) for complex indices and wavelengths in nm."""
    return 4.0 * np.pi * index.imag / (np.asarray(wavelength_nm, dtype=float) * 1e-9)
