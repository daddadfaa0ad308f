"""BRDFs as BiRDview opens them: the universal BRDF format, JSON in a file named ``.brdf``.

Lanevski et al. 2022, Color Research & Application 47, 1177-1192, with its example and its schema
``brdf_json_schema_v1.0.json``.  Where that schema contradicts itself (it asks for a ``name`` of the
data, an ``index`` of ``phi_r`` and a ``unit`` of polarization, and allows none of them), the
example is followed.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import check_no_gaps
from splits.core.atomic import atomic_write
from splits.core.parameter_names import describe_parameter
from splits.core.provenance import get_package_version
from splits.core.validation import invalid, reject_unknown_arguments

BRDF_SCHEMA_URL = "https://raw.githubusercontent.com/BiRD-project/BiRD_view/master/BRDF_JSON_schema/brdf_json_schema_v1.0.json"
LOCATION_KEYS = ("country", "city", "street", "building_nr", "postal_code")
PROVENANCE_KEYS = ("organization", "location", "email", "contact_person")
"""What the format asks for about who made the data."""

MODEL_DESCRIPTIONS = {
    "snow": "Rays among grains generated on the fly (SPLITSnow: Varsa, Baranoski and Kimmel 2021)",
    "sand": "Rays among grains generated on the fly (SPLITS: Kimmel and Baranoski 2007)",
    "particle_layer": "Rays in a scattering layer under a surface (Budak and Grimailo 2020)",
}


@reject_unknown_arguments
def save_brdf(
    datasets: xr.Dataset | Sequence[xr.Dataset],
    path: str | Path,
    provenance: Mapping[str, Any],
    license: Mapping[str, str] | None = None,
) -> None:
    """Write BRDFs of one medium as BiRDview opens them.

    A line for each wavelength, incidence and direction.  Both azimuths count from the side that the
    light comes from: its own, ``phi_i``, is 0, and ``phi_r`` is 180° more than ours, 0 where light
    goes back to the source and 180 in the specular direction.  ``uBRDF`` is one standard error.
    Where the Stokes vector was followed, each direction has three lines: of all light, and of what
    passes a polarizer across (s) and along (p) the plane that holds the normal.

    Parameters
    ----------
    datasets : xarray.Dataset or sequence of them
        As `splits.goniophotometer` returns them, one for each angle of incidence.
    path : path
        Ending in ``.brdf`` or ``.json``.  The file appears whole or not at all.
    provenance : mapping
        Who made the data, as the format asks: ``organization``, ``location`` (a mapping of
        ``country``, ``city``, ``street``, ``building_nr``, ``postal_code``), ``email`` and
        ``contact_person``; whatever else it knows, as ``website``.
    license : mapping, optional
        ``type`` and ``rights_holder`` of the data's licence; whatever else it knows, as ``link``.

    Raises
    ------
    ValueError
        For a dataset without a BRDF, as under diffuse light, for several media at once, and for
        provenance that is not complete.

    References
    ----------
    Lanevski et al. (2022).
    """
    given = [datasets] if isinstance(datasets, xr.Dataset) else list(datasets)
    _check_input(given, path, provenance, license)
    first = given[0].attrs
    medium = str(first["medium"])
    columns, left_out = _collect_columns(given)
    angles = ", ".join(f"{ds.attrs['incidence_deg']:g}°" for ds in given)
    about = {
        "schema": BRDF_SCHEMA_URL,
        "id": f"urn:splits:{first['physics_sources_sha256']}:{first['seed']}",
        "type": "BRDF",
        "timestamp": first["date_created"],
        "provenance": dict(provenance),
        **({"license": dict(license)} if license else {}),
        "description": f"Simulated BRDF of {medium} under a beam from {angles}",
        "method": "simulation",
        "instrumentation": "NA",
        "software": _describe_software(first, medium),
        "sample": {
            "name": medium,
            "type": "virtual sample",
            "zero_azimuth_location": "the side from which the light comes",
            "properties_symmetry": "bilaterally symmetric in respect to the plane of incidence",
        },
        "environment": "NA",
        "comments": f"Light that was never scattered is not in it. Values left out because noise "
        f"makes them negative: {left_out}.",
    }
    content = json.dumps({"metadata": about, "data": columns}, ensure_ascii=False, allow_nan=False)
    with atomic_write(path) as aside:
        aside.write_text(content, encoding="utf-8")


def _check_input(
    datasets: Sequence[xr.Dataset],
    path: str | Path,
    provenance: Mapping[str, Any],
    license: Mapping[str, str] | None,
) -> None:
    """Refuse what cannot be written."""
    if not datasets:
        raise invalid("datasets", [], "at least one dataset")
    if Path(path).suffix not in (".brdf", ".json"):
        raise invalid("path", path, "a name that ends in .brdf or .json")
    for ds in datasets:
        if "brdf" not in ds.data_vars or set(ds.brdf.dims) != {"wavelength", "polar", "azimuth"}:
            title = ds.attrs.get("title", "a dataset")
            raise invalid("datasets", title, "what splits.goniophotometer returns of a beam")
        check_no_gaps("datasets", ds[[n for n in ds.data_vars if str(n).startswith("brdf")]])
        if _get_medium_attributes(ds.attrs) != _get_medium_attributes(datasets[0].attrs):
            other = "another medium"
            raise invalid("datasets", other, "the same for all", "write a file for each medium")
    angles = [float(ds.attrs["incidence_deg"]) for ds in datasets]
    if len(set(angles)) < len(angles):
        raise invalid("datasets", angles, "of different angles of incidence")
    missing = [name for name in PROVENANCE_KEYS if name not in provenance]
    missing += [
        f"location.{name}" for name in LOCATION_KEYS if name not in provenance.get("location", {})
    ]
    if missing:
        hint = "the format asks for all of these"
        raise invalid("provenance", sorted(provenance), f"with {', '.join(missing)}", hint)
    lacks = [name for name in ("type", "rights_holder") if license and name not in license]
    if lacks:
        raise invalid("license", sorted(license or {}), f"with {', '.join(lacks)}")


def _get_medium_attributes(attrs: Mapping[str, Any]) -> dict[str, str]:
    """Return what a dataset says of its medium, as text."""
    medium = str(attrs["medium"])
    return {k: str(v) for k, v in attrs.items() if k.startswith(f"{medium}_")}


def _describe_software(attrs: Mapping[str, Any], medium: str) -> dict[str, Any]:
    """Return the section on the model and its parameters: numbers apart, as the format asks."""
    own = {
        key.removeprefix(f"{medium}_"): value
        for key, value in attrs.items()
        if key.startswith(f"{medium}_")
    }
    numbers, others = [], {}
    for name, value in own.items():
        if name.removesuffix("_stderr") != name:
            continue
        if np.ndim(value) or not isinstance(value, int | float | np.number):
            others[name] = np.asarray(value).tolist()
        elif np.isfinite(value):
            # Layers of a stack are layers_0_depth_m in attributes, layers.0.depth_m elsewhere.
            about, units = describe_parameter(re.sub(r"^layers_(\d+)_", r"layers.\1.", name))
            one = {"name": name, "description": about, "value": float(value), "unit": units}
            if f"{name}_stderr" in own:
                one |= {"uncertainty": float(own[f"{name}_stderr"]), "uncertainty_unit": units}
            numbers.append(one)
    model = {
        "name": f"splits, {medium}",
        "description": MODEL_DESCRIPTIONS.get(medium, "Rays among grains, layer by layer"),
        "parameters": numbers,
        "adhoc_section": others,
    }
    return {
        "name": "splits",
        "version": get_package_version(),
        "description": "Light that sand, snow and rough layers send back, by Monte Carlo",
        "simulation_model": model,
    }


def _collect_columns(datasets: Sequence[xr.Dataset]) -> tuple[dict[str, Any], int]:
    """Return the data of all, and how many values were left out because they are negative."""
    rows: dict[str, list[Any]] = {
        name: [] for name in ("wavelength", "incidence", "polar", "azimuth", "state", "f", "u")
    }
    left_out = 0
    for ds in datasets:
        w, polar, azimuth = np.meshgrid(
            ds.wavelength.values, ds.polar.values, ds.azimuth.values, indexing="ij"
        )
        back = np.mod(azimuth + 180.0, 360.0)
        for state, f, u in _split_polarization(ds.transpose("wavelength", "polar", "azimuth", ...)):
            good = f >= 0.0
            left_out += int((~good).sum())
            count = int(good.sum())
            rows["wavelength"] += w[good].tolist()
            rows["incidence"] += [float(ds.attrs["incidence_deg"])] * count
            rows["polar"] += polar[good].tolist()
            rows["azimuth"] += back[good].tolist()
            rows["state"] += [state] * count
            rows["f"] += [float(f"{x:.6g}") for x in f[good]]
            rows["u"] += [float(f"{x:.3g}") for x in u[good]]
    count = len(rows["f"])
    return {
        "wavelength_i": {"unit": "nm", "values": rows["wavelength"]},
        "polarization_i": {"notation": "sp", "values": ["u"] * count},
        "polarization_r": {"notation": "sp", "values": rows["state"]},
        "theta_i": {"unit": "deg", "values": rows["incidence"]},
        "phi_i": {"unit": "deg", "values": [0.0] * count},
        "theta_r": {"unit": "deg", "values": rows["polar"]},
        "phi_r": {"unit": "deg", "values": rows["azimuth"]},
        "BRDF": {"unit": "sr^-1", "values": rows["f"]},
        "uBRDF": {
            "unit": "sr^-1",
            "values": rows["u"],
            "comments": "One standard error. Of s and p at most that: half the sum of those of "
            "all light and of its difference.",
        },
    }, left_out


def _split_polarization(ds: xr.Dataset) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return values and errors by what the detector takes: all light, or s and p besides.

    Our Q is positive along the plane that holds the normal, which the format calls p.
    """
    f, u = ds.brdf.values, ds.brdf_stderr.values
    found = [("u", f, u)]
    if "brdf_q" in ds.data_vars:
        q, error = ds.brdf_q.values, 0.5 * (u + ds.brdf_q_stderr.values)
        found += [("s", 0.5 * (f - q), error), ("p", 0.5 * (f + q), error)]
    return found
