"""Universal BRDF format of BiRDview: JSON in a file with the suffix ``.brdf``.

The format is that of Lanevski et al. (2022, Color Research & Application 47, 1177-1192).  Files are
valid by its schema ``brdf_json_schema_v1.0.json`` as of 21 November 2024.
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
from splits.core.incident_stokes import UNPOLARIZED_LIGHT, get_incident_stokes
from splits.core.keywords import reject_unknown_arguments
from splits.core.parameter_names import describe_parameter
from splits.core.provenance import get_package_version
from splits.core.validation import invalid

BRDF_SCHEMA_URL = "https://raw.githubusercontent.com/BiRD-project/BiRD_view/master/BRDF_JSON_schema/brdf_json_schema_v1.0.json"
LOCATION_KEYS = ("country", "city", "street", "building_nr", "postal_code")
PROVENANCE_KEYS = ("organization", "location", "email", "contact_person")
"""Required keys of the provenance section."""

MODEL_DESCRIPTIONS = {
    "snow": "Ray tracing among random grains (SPLITSnow: Varsa, Baranoski and Kimmel 2021)",
    "sand": "Ray tracing among random grains (SPLITS: Kimmel and Baranoski 2007)",
    "particle_layer": "Ray tracing in a layer under a rough surface (Budak and Grimailo 2020)",
}


@reject_unknown_arguments
def save_brdf(
    datasets: xr.Dataset | Sequence[xr.Dataset],
    path: str | Path,
    provenance: Mapping[str, Any],
    license: Mapping[str, str] | None = None,
) -> None:
    """Write BRDFs of a medium in the universal BRDF format of BiRDview.

    The file has a row for each wavelength, incidence and direction.  Both azimuths are measured
    from the side of the light source: ``phi_i`` is 0, and ``phi_r`` is the azimuth of this package
    plus 180°, so that it is 0 for backscattering and 180 for the specular direction.  ``uBRDF`` is
    one standard error.  With the Stokes vector, each direction has three rows: for all light, and
    for light polarized perpendicular (s) and parallel (p) to the plane of the direction and the
    normal.

    Parameters
    ----------
    datasets : xarray.Dataset or sequence of them
        Results of `splits.goniophotometer`, one for each angle of incidence.
    path : path
        File with the suffix ``.brdf`` or ``.json``, written atomically.
    provenance : mapping
        Origin of the data, as required by the format: ``organization``, ``location`` (a mapping of
        ``country``, ``city``, ``street``, ``building_nr``, ``postal_code``), ``email`` and
        ``contact_person``; other keys of the format, such as ``website``, are optional.
    license : mapping, optional
        ``type`` and ``rights_holder`` of the licence of the data; other keys of the format, such as
        ``link``, are optional.

    Raises
    ------
    ValueError
        For a dataset without a BRDF, such as one of diffuse incidence, for datasets of different
        media, and for incomplete provenance.

    References
    ----------
    Lanevski et al. (2022).
    """
    dataset_list = [datasets] if isinstance(datasets, xr.Dataset) else list(datasets)
    _check_input(dataset_list, path, provenance, license)
    attrs = dataset_list[0].attrs
    medium = str(attrs["medium"])
    columns, n_omitted = _collect_columns(dataset_list)
    angles = ", ".join(f"{ds.attrs['incidence_deg']:g}°" for ds in dataset_list)
    metadata = {
        "schema": BRDF_SCHEMA_URL,
        "id": f"urn:splits:{attrs['physics_sources_sha256']}:{attrs['seed']}",
        "type": "BRDF",
        "timestamp": attrs["date_created"],
        "provenance": dict(provenance),
        **({"license": dict(license)} if license else {}),
        "description": f"Simulated BRDF of {medium} under a beam from {angles}",
        "method": "simulation",
        "instrumentation": "NA",
        "software": _describe_software(attrs, medium),
        "sample": {
            "name": medium,
            "type": "virtual sample",
            "dimensions": {"comments": "infinite in the horizontal directions"},
            "shape": "layer",
            "zero_azimuth_location": "the side from which the light comes",
            "properties_symmetry": "bilaterally symmetric in respect to the plane of incidence",
        },
        "environment": "NA",
        "comments": f"Unscattered light is excluded. Number of values omitted because noise "
        f"makes them negative: {n_omitted}.",
    }
    content = json.dumps(
        {"metadata": metadata, "data": columns}, ensure_ascii=False, allow_nan=False
    )
    with atomic_write(path) as temporary:
        temporary.write_text(content, encoding="utf-8")


def _check_input(
    datasets: Sequence[xr.Dataset],
    path: str | Path,
    provenance: Mapping[str, Any],
    license: Mapping[str, str] | None,
) -> None:
    """Check that datasets, path and metadata can be written in the format."""
    if not datasets:
        raise invalid("datasets", [], "at least one dataset")
    if Path(path).suffix not in (".brdf", ".json"):
        raise invalid("path", path, "a name that ends in .brdf or .json")
    for ds in datasets:
        if "brdf" not in ds.data_vars or set(ds.brdf.dims) != {"wavelength", "polar", "azimuth"}:
            title = ds.attrs.get("title", "a dataset")
            raise invalid("datasets", title, "the result of splits.goniophotometer for a beam")
        check_no_gaps("datasets", ds[[n for n in ds.data_vars if str(n).startswith("brdf")]])
        stokes = get_incident_stokes(ds.attrs)
        if stokes != UNPOLARIZED_LIGHT:
            raise invalid("datasets", stokes, "of unpolarized incident light", "by this function")
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
        hint = "the format requires all of these"
        raise invalid("provenance", sorted(provenance), f"with {', '.join(missing)}", hint)
    missing_license_keys = [
        name for name in ("type", "rights_holder") if license and name not in license
    ]
    if missing_license_keys:
        raise invalid("license", sorted(license or {}), f"with {', '.join(missing_license_keys)}")


def _get_medium_attributes(attrs: Mapping[str, Any]) -> dict[str, str]:
    """Return the attributes of the medium of a dataset, as text."""
    medium = str(attrs["medium"])
    return {k: str(v) for k, v in attrs.items() if k.startswith(f"{medium}_")}


def _describe_software(attrs: Mapping[str, Any], medium: str) -> dict[str, Any]:
    """Return the section on the model, with numeric and other parameters separated."""
    medium_attrs = {
        key.removeprefix(f"{medium}_"): value
        for key, value in attrs.items()
        if key.startswith(f"{medium}_")
    }
    numbers, other_inputs = [], {}
    for name, value in medium_attrs.items():
        if name.removesuffix("_stderr") != name:
            continue
        if np.ndim(value) or not isinstance(value, int | float | np.number):
            other_inputs[name] = np.asarray(value).tolist()
        elif np.isfinite(value):
            # Layers of a stack are layers_0_depth_m in attributes, layers.0.depth_m elsewhere.
            description, units = describe_parameter(re.sub(r"^layers_(\d+)_", r"layers.\1.", name))
            parameter = {
                "name": name,
                "description": description,
                "value": float(value),
                "unit": units,
            }
            if f"{name}_stderr" in medium_attrs:
                parameter |= {
                    "uncertainty": float(medium_attrs[f"{name}_stderr"]),
                    "uncertainty_unit": units,
                }
            numbers.append(parameter)
    model = {
        "name": f"splits, {medium}",
        "description": MODEL_DESCRIPTIONS.get(
            medium, "Ray tracing in layers of grains or particles"
        ),
        "parameters": numbers,
        "adhoc_section": other_inputs,
    }
    return {
        "name": "splits",
        "version": get_package_version(),
        "description": "Monte Carlo reflectance and transmittance of snow, sand and rough layers",
        "simulation_model": model,
    }


def _collect_columns(datasets: Sequence[xr.Dataset]) -> tuple[dict[str, Any], int]:
    """Return the data columns, and the number of negative values omitted."""
    rows: dict[str, list[Any]] = {
        name: [] for name in ("wavelength", "incidence", "polar", "azimuth", "state", "f", "u")
    }
    n_omitted = 0
    for ds in datasets:
        w, polar, azimuth = np.meshgrid(
            ds.wavelength.values, ds.polar.values, ds.azimuth.values, indexing="ij"
        )
        azimuth_r = np.mod(azimuth + 180.0, 360.0)
        for state, f, u in _split_polarization(ds.transpose("wavelength", "polar", "azimuth", ...)):
            valid = f >= 0.0
            n_omitted += int((~valid).sum())
            n_rows = int(valid.sum())
            rows["wavelength"] += w[valid].tolist()
            rows["incidence"] += [float(ds.attrs["incidence_deg"])] * n_rows
            rows["polar"] += polar[valid].tolist()
            rows["azimuth"] += azimuth_r[valid].tolist()
            rows["state"] += [state] * n_rows
            rows["f"] += [float(f"{x:.6g}") for x in f[valid]]
            rows["u"] += [float(f"{x:.3g}") for x in u[valid]]
    n_rows = len(rows["f"])
    return {
        "wavelength_i": {"unit": "nm", "values": rows["wavelength"]},
        "polarization_i": {"notation": "sp", "values": ["u"] * n_rows},
        "polarization_r": {"notation": "sp", "values": rows["state"]},
        "theta_i": {"unit": "deg", "values": rows["incidence"]},
        "phi_i": {"unit": "deg", "values": [0.0] * n_rows},
        "theta_r": {"unit": "deg", "values": rows["polar"]},
        "phi_r": {"unit": "deg", "values": rows["azimuth"]},
        "BRDF": {"unit": "sr^-1", "values": rows["f"]},
        "uBRDF": {
            "unit": "sr^-1",
            "values": rows["u"],
            "comments": "One standard error; for s and p an upper bound, half the sum of the "
            "errors of the BRDF and of its Stokes component Q.",
        },
    }, n_omitted


def _split_polarization(ds: xr.Dataset) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return values and errors by polarization state: all light, and s and p if available.

    Q is positive for light polarized parallel to the plane of the normal, p in the format.
    """
    f, u = ds.brdf.values, ds.brdf_stderr.values
    states = [("u", f, u)]
    if "brdf_q" in ds.data_vars:
        q, error = ds.brdf_q.values, 0.5 * (u + ds.brdf_q_stderr.values)
        states += [("s", 0.5 * (f - q), error), ("p", 0.5 * (f + q), error)]
    return states
