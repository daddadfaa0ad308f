"""Tables of a published law of snow's albedo, to be read beside those of this model."""

from __future__ import annotations

import numpy as np
import snowoptics
import xarray as xr

from splits.core.parameter_names import parse_impurity_parameter
from splits.core.validation import invalid
from splits.materials.impurities import make_impurities
from splits.media.measured_inputs import OPTICAL_RADIUS_KEY, SURFACE_AREA_KEY
from splits.tables.axes import INCIDENCE
from splits.tables.table import Table

KOKHANOVSKY_ZEGE = "kokhanovsky_zege_2004"
ALBEDO_LAWS = (KOKHANOVSKY_ZEGE,)
ICE_DENSITY_KG_M3 = 917.0
"""Of the law's own scattering."""
FORMULA_STDERR = 1e-6
"""Standard error of a formula, as a table has to have one."""
IMPURITY_KEYWORD = "impurities_ng_g"


def make_law_table(
    table: Table, law: str = KOKHANOVSKY_ZEGE, model_axis: str | None = None
) -> Table:
    """Return what a law says of the snow of a table, over the axes that it knows.

    Kokhanovsky & Zege (2004, Appl. Opt. 43, 1589-1602, doi:10.1364/AO.43.001589) for deep snow, as
    the package snowoptics has it with its shape of grains.  What impurities absorb is added to ice,
    as that package does for soot: a share c of mass, of a mass absorption coefficient M, adds
    2 c M/SSA to 1 − ω.

    Parameters
    ----------
    table : MethodTable
        Its other axes, of which the law knows nothing (liquid water), have to hold 0.
    law : {"kokhanovsky_zege_2004"}
    model_axis : str, optional
        An axis of models, beside which the law stands.

    Returns
    -------
    Table

    Raises
    ------
    ValueError
        For a table without sizes, or with an axis of which the law knows nothing and that has no 0.
    """
    given = table.dataset
    axes = [a for a in table.axes if a != "wavelength"]
    size = next((a for a in axes if a in (SURFACE_AREA_KEY, OPTICAL_RADIUS_KEY)), None)
    if size is None:
        raise invalid(
            "retrieve.compare_with",
            law,
            f"with {SURFACE_AREA_KEY} or {OPTICAL_RADIUS_KEY} on the grid",
        )
    kept = [
        a
        for a in axes
        if a in (size, INCIDENCE) or (parse_impurity_parameter(a) or ("",))[0] == IMPURITY_KEYWORD
    ]
    for name in [a for a in axes if a not in (*kept, model_axis)]:
        if given[name].dtype.kind != "f" or float(given[name].values.min()) != 0.0:
            raise invalid(
                "retrieve.compare_with", law, f"left out where {name} is on the grid without 0"
            )
    w = given.wavelength.values
    ice, absorbed = snowoptics.refice(1e-9 * w, "p2016")
    shape = [given.sizes[a] for a in kept]
    values = np.empty((*shape, w.size))
    for place in np.ndindex(*shape):
        at = {a: given[a].values[i] for a, i in zip(kept, place, strict=True)}
        amounts = {
            str(parsed[1]): float(at[a]) for a in kept if (parsed := parse_impurity_parameter(a))
        }
        per_ice = sum(
            (one.compute_absorption_per_kg_ice(w) for one in make_impurities(amounts, {})),
            np.zeros(w.size),
        )
        # In 1/m of ice, and as the imaginary part of an index, which the law takes.
        more = per_ice * ICE_DENSITY_KG_M3 / snowoptics.default_B * (1e-9 * w) / (4.0 * np.pi)
        area = at[size] if size == SURFACE_AREA_KEY else 3e6 / (ICE_DENSITY_KG_M3 * at[size])
        beam = at.get(INCIDENCE, given.attrs.get(INCIDENCE, 0.0))
        values[place] = _compute_albedo(1e-9 * w, beam, float(area), (ice, absorbed + more))
    dims = (*kept, "wavelength")
    coordinates = {a: given[a] for a in dims}
    about = given.reflectance.attrs
    stderr = np.full(values.shape, FORMULA_STDERR)
    return Table(
        xr.Dataset(
            {"reflectance": (dims, values, about), "reflectance_stderr": (dims, stderr, about)},
            coordinates,
            {"title": law, "path_sharing_axes": "none"},
        )
    )


def _compute_albedo(
    wavelength_m: np.ndarray,
    incidence: object,
    ssa_m2_kg: float,
    index: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Return the albedo of deep snow under a beam (degrees), or under diffuse light."""
    if incidence == "diffuse":
        found = snowoptics.albedo_diffuse_KZ04(wavelength_m, ssa_m2_kg, ni=index[1])
    else:
        found = snowoptics.albedo_direct_KZ04(
            wavelength_m, np.radians(float(str(incidence))), ssa_m2_kg, ni=index[1]
        )
    return np.asarray(found, dtype=float)
