"""Complex refractive index n + i k from a user's input: named dataset, constant or table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from splits.core.arrays import read_columns
from splits.core.validation import (
    InvalidValue,
    as_scalar,
    check_choice,
    check_number,
    check_range,
    invalid,
)
from splits.materials.csv_table import is_csv_path, read_user_table, to_columns
from splits.materials.library import list_datasets, load_dataset
from splits.materials.refractive_index import (
    ConstantIndex,
    RefractiveIndex,
    ScaledIndex,
    TabulatedIndex,
)


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
    if isinstance(spec, Mapping) and {"dataset", "k_factor"} & set(spec):
        return _make_scaled_index(f"refractive_index[{material}]", material, spec)
    return parse_refractive_index(material, spec, names)


def parse_refractive_index(
    material: str, spec: Any, dataset_names: Sequence[str] = ()
) -> RefractiveIndex:
    """Return the refractive index for an input other than None; see `make_refractive_index`."""
    key, spec = f"refractive_index[{material}]", to_columns(spec)
    if isinstance(spec, str):
        if spec in dataset_names:
            return load_dataset(material, spec)
        if is_csv_path(spec):
            return _load_user_index(key, Path(spec))
        try:
            return ConstantIndex(complex(spec.replace(" ", "")))
        except InvalidValue:
            raise
        except ValueError:
            check_choice(key, spec, [*dataset_names, "a complex number", "a .csv file"])
    if isinstance(spec, Path):
        return _load_user_index(key, spec)
    if isinstance(spec, Mapping):
        return _make_user_index(key, material, spec)
    spec = as_scalar(spec)
    if isinstance(spec, (int, float, complex)) and not isinstance(spec, bool):
        return ConstantIndex(
            spec if isinstance(spec, complex) else complex(check_number(key, spec))
        )
    if callable(spec) and hasattr(spec, "name"):
        return spec
    raise invalid(key, spec, "a dataset name, a complex constant, a table or a CSV file")


def _make_scaled_index(key: str, material: str, spec: Mapping[str, Any]) -> RefractiveIndex:
    if set(spec) - {"dataset", "k_factor"}:
        raise invalid(key, dict(spec), "a mapping of dataset and k_factor only")
    names = list_datasets(material)
    index = load_dataset(
        material, check_choice(f"{key}.dataset", spec.get("dataset", names[0]), names)
    )
    if "k_factor" not in spec:
        return index
    factor = check_range(f"{key}.k_factor", spec["k_factor"], 0.0, np.inf, open_low=True)
    return ScaledIndex(index, factor)


def _make_user_index(key: str, material: str, spec: Mapping[str, Any]) -> RefractiveIndex:
    if set(spec) - {"wavelength_nm", "n", "k"} or "n" not in spec:
        allowed = "a mapping of n, k and, for a table, wavelength_nm, or of dataset and k_factor"
        raise invalid(key, dict(spec), allowed)
    k = spec.get("k", 0.0)
    if "wavelength_nm" not in spec:
        return ConstantIndex(
            complex(check_number(f"{key}.n", spec["n"]), check_number(f"{key}.k", k))
        )
    columns = {"wavelength_nm": spec["wavelength_nm"], "n": spec["n"], "k": k}
    w, n, k = read_columns(key, columns)
    k = np.broadcast_to(k, w.shape) if k.size == 1 else k
    return TabulatedIndex(f"user table for {material}", "given by the user", w, n, k)


def _load_user_index(key: str, path: Path) -> TabulatedIndex:
    (w, n, k), digest = read_user_table(key, path, ("wavelength_nm", "n", "k"))
    return TabulatedIndex(path.name, "table of the user", w, n, k, digest)


def absorption_coefficient(index: np.ndarray, wavelength_nm: np.ndarray) -> np.ndarray:
    """Return the absorption coefficient α = 4πk/λ (1/m), SPLITSnow Eq 6; wavelengths in nm."""
    return 4.0 * np.pi * index.imag / (np.asarray(wavelength_nm, dtype=float) * 1e-9)
