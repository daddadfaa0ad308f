"""Tables of a published law of snow albedo, for comparison with those of this model."""

from __future__ import annotations

from typing import Any

import numpy as np
import snowoptics
import xarray as xr

from splits.core.inputs import DIFFUSE
from splits.core.validation import invalid
from splits.materials.impurities import make_impurities
from splits.media.parameters import parse_impurity_parameter
from splits.media.snow import OPTICAL_RADIUS_KEY, SURFACE_AREA_KEY
from splits.tables.axes import INCIDENCE
from splits.tables.table import Table

KOKHANOVSKY_ZEGE = "kokhanovsky_zege_2004"
ICE_DENSITY_KG_M3 = 917.0
"""Density of ice in the law (kg/m³)."""
FORMULA_STDERR = 1e-6
"""Nominal standard error of a formula, which a table requires."""
IMPURITY_KEYWORD = "impurities_ng_g"


def make_law_table(
    table: Table, law: str = KOKHANOVSKY_ZEGE, model_axis: str | None = None
) -> Table:
    """Return the table of a law for the snow of a table, over the axes of the law.

    The law is that of Kokhanovsky & Zege (2004, Appl. Opt. 43, 1589-1602,
    doi:10.1364/AO.43.001589) for deep snow, with the shape factors of the package snowoptics.
    Absorption of impurities is added to that of ice as in this package: a mass fraction c with the
    mass absorption coefficient M adds 2 c M/SSA to 1 − ω.

    Parameters
    ----------
    table : Table
        Axes that the law does not have (liquid water) must contain 0.
    law : {"kokhanovsky_zege_2004"}
    model_axis : str, optional
        An axis of models, with which the law is compared.

    Returns
    -------
    Table

    Raises
    ------
    ValueError
        For a table without sizes, or with another axis that does not contain 0.
    """
    dataset = table.dataset
    axes = [axis for axis in table.axes if axis != "wavelength"]
    size = next((axis for axis in axes if axis in (SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY)), None)
    if size is None:
        allowed = f"with {SURFACE_AREA_KEY} or {OPTICAL_RADIUS_KEY} on the grid"
        raise invalid("retrieve.compare_with", law, allowed)
    law_axes = [
        axis
        for axis in axes
        if axis in (size, INCIDENCE)
        or (parse_impurity_parameter(axis) or ("",))[0] == IMPURITY_KEYWORD
    ]
    for name in [axis for axis in axes if axis not in (*law_axes, model_axis)]:
        if dataset[name].dtype.kind != "f" or float(dataset[name].values.min()) != 0.0:
            raise invalid(
                "retrieve.compare_with", law, f"left out where {name} is on the grid without 0"
            )
    wavelength = dataset.wavelength.values
    _, absorbed = snowoptics.refice(1e-9 * wavelength, "p2016")
    shape = [dataset.sizes[axis] for axis in law_axes]
    values = np.empty((*shape, wavelength.size))
    for index in np.ndindex(*shape):
        point = {a: dataset[a].values[i] for a, i in zip(law_axes, index, strict=True)}
        k = absorbed + _compute_impurity_k(point, wavelength)
        by_area = size == SURFACE_AREA_KEY
        area = float(point[size] if by_area else 3e6 / (ICE_DENSITY_KG_M3 * point[size]))
        incidence = point.get(INCIDENCE, dataset.attrs.get(INCIDENCE, 0.0))
        if incidence == DIFFUSE:
            values[index] = snowoptics.albedo_diffuse_KZ04(1e-9 * wavelength, area, ni=k)
        else:
            angle = np.radians(float(incidence))
            values[index] = snowoptics.albedo_direct_KZ04(1e-9 * wavelength, angle, area, ni=k)
    dims = (*law_axes, "wavelength")
    coordinates = {axis: dataset[axis] for axis in dims}
    attributes = dataset.reflectance.attrs
    stderr = np.full(values.shape, FORMULA_STDERR)
    return Table(
        xr.Dataset(
            {
                "reflectance": (dims, values, attributes),
                "reflectance_stderr": (dims, stderr, attributes),
            },
            coordinates,
            {"title": law, "path_sharing_axes": "none"},
        )
    )


def _compute_impurity_k(point: dict[str, Any], wavelength_nm: np.ndarray) -> np.ndarray:
    """Return the absorption of impurities as an imaginary part of the refractive index of ice."""
    amounts = {
        str(parsed[1]): float(value)
        for axis, value in point.items()
        if (parsed := parse_impurity_parameter(axis))
    }
    impurities = make_impurities(amounts, {})
    per_ice = sum(
        (impurity.compute_absorption_per_kg_ice(wavelength_nm) for impurity in impurities),
        np.zeros(wavelength_nm.size),
    )
    return np.asarray(
        per_ice * ICE_DENSITY_KG_M3 / snowoptics.default_B * (1e-9 * wavelength_nm) / (4.0 * np.pi)
    )
