"""Sunlight inside a sample: irradiances at depths, and the power absorbed between them."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from splits.analysis.errors import weighted_error
from splits.checks import in_range, known_arguments
from splits.instruments import profile
from splits.instruments.arguments import check_threads, check_whole
from splits.instruments.labels import run_facts
from splits.instruments.progress import Report
from splits.media.granular import GranularMedium, LayeredMedium
from splits.skies.irradiance import Sky
from splits.skies.mixing import asked, light_of, mixed, sky_facts
from splits.uncertainty import Variable, quantity

NAMES = {
    "downward_irradiance": ("downward_irradiance", "downward irradiance"),
    "upward_irradiance": ("upward_irradiance", "upward irradiance"),
    "absorptance": ("absorbed_power", "absorbed power of the interval"),
}
"""Variables of a profile, and what becomes of them in sunlight."""


@known_arguments
def light_inside(
    medium: GranularMedium | LayeredMedium,
    sky: Sky | str | Mapping[str, Any],
    depth_m: Any,
    wavelength_nm: Any = None,
    max_stderr: float = 0.005,
    seed: int = 1,
    *,
    total_w_m2: float | None = None,
    bands: Mapping[str, Any] | str | None = None,
    threads: int | None = None,
    progress: Report = None,
) -> xr.Dataset:
    """Measure the light of a sky inside a medium of grains, and the power that is absorbed there.

    Parameters
    ----------
    medium : GranularMedium or LayeredMedium
        That ends, for example `splits.Snow` or `splits.Stack`.
    sky : Sky, str or mapping
        See `splits.sky`.
    depth_m : array_like
        Strictly increasing depths (m) inside the medium; its top and its bottom are added.  Faces
        of a stack's layers among them give the power absorbed by each layer.
    wavelength_nm : array_like, optional
        Strictly increasing vacuum wavelengths (nm), at least two; by default every 10 nm from the
        first of the sky to 2495.  Light beyond them is left out, see ``irradiance_covered``.
    max_stderr : float
        Largest standard error wanted for any irradiance or absorbed share at any wavelength, as a
        part of the irradiance from above, of the light of the sun and of the diffuse light each.
    seed : int
        Non-negative; diffuse light takes the next.
    total_w_m2 : float, optional
        Irradiance from above at all wavelengths of the sky (W m⁻²), to which it is scaled; the
        skies of SNICAR need it.
    bands : mapping or str, optional
        As for `splits.albedo`: ``{"photosynthetic": (400, 700)}``.
    threads : int, optional
        Default: every CPU this process may use.
    progress : callable or bool, optional
        True shows a bar; a function is called now and then with a `Progress`.

    Returns
    -------
    xarray.Dataset
        Over ``band``, the first of which is "broadband", and ``depth``: ``downward_irradiance`` and
        ``upward_irradiance`` (W m⁻²).  Over ``band`` and ``interval``, between successive depths:
        ``absorbed_power`` (W m⁻²).  All with standard errors ``…_stderr``.  Over ``band``
        ``irradiance_covered``, the part of the band's light within the wavelengths.

    Raises
    ------
    ValueError
        For a value outside its range, or wavelengths that the sky does not have.

    Examples
    --------
    >>> import splits
    >>> snow = splits.Snow.natural(specific_surface_area_m2_kg=30, depth_m=0.1)
    >>> sky = splits.sky("midlatitude_winter")
    >>> ds = splits.light_inside(snow, sky, [0.02], [400, 700, 1000], 0.05, total_w_m2=400)
    >>> ds.absorbed_power.dims
    ('band', 'interval')
    """
    begun = time.perf_counter()
    light = light_of(sky).scaled_to(total_w_m2)
    w = asked(wavelength_nm, light, 2)
    max_stderr = in_range("max_stderr", max_stderr, 1e-6, 0.5)
    seed, threads = check_whole("seed", seed, 0), check_threads(threads)
    named = light.bands(bands)
    light.check_bands(named, w)
    axes: dict[str, Any] = {}

    def run(incidence: float | str, number: int) -> xr.Dataset:
        found = profile(
            medium,
            w,
            depth_m,
            incidence,
            max_stderr,
            seed + number,
            threads=threads,
            progress=progress,
        )
        axes.update({name: found[name] for name in ("depth", "interval_top", "interval_bottom")})
        return found

    found = mixed(light, w, run, list(NAMES))
    variables: dict[str, Variable] = {}
    weights = np.array([light.weights(w, band) for band in named.values()])
    each = xr.DataArray(weights, {"wavelength": w}, ("band", "wavelength"))
    for name, (label, long_name) in NAMES.items():
        value = (each * found[name]).sum("wavelength")
        error = xr.concat([weighted_error(found, name, one) for one in each], "band")
        place = next(dim for dim in value.dims if dim != "band")
        dims = ("band", str(place))
        variables |= quantity(
            label, dims, value.transpose(*dims).values, error.transpose(*dims).values, long_name,
            "W m-2",
        )  # fmt: skip
    whole = [light.weights(light.wavelength_nm, band).sum() for band in named.values()]
    about = {"long_name": "part of the band's light within the wavelengths", "units": "1"}
    variables["irradiance_covered"] = ("band", weights.sum(axis=1) / whole, about)
    facts = {
        **run_facts("Sunlight inside", "light_inside", medium, begun, seed, threads),
        **sky_facts(light),
        "irradiance_w_m2": whole[0],
        "max_stderr": max_stderr,
    }
    return xr.Dataset(variables, {**axes, "band": list(named)}, facts)
