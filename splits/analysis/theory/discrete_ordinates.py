"""Radiative transfer in layers over a ground, by discrete ordinates."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from splits.analysis.theory.asymptotic import compute_incidence_cosine
from splits.analysis.theory.error_propagation import propagate_errors
from splits.core.optional import import_optional
from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import invalid
from splits.media.ground import Ground, describe_ground

MAX_ALBEDO = 1.0 - 1e-9
"""PythonicDISORT refuses an albedo of 1 and loses digits as it comes near: at 1 − 10⁻⁹ fluxes are
good to 10⁻⁶, while an optical thickness of 1000 absorbs 10⁻⁵ more than it should at most."""

OPTICS_INPUTS = ("optical_thickness", "single_scattering_albedo", "legendre_moment")
"""What discrete ordinates take of the optics."""

N_RESPONSE_STREAMS = 8
"""Streams that tell how results respond to small changes of the optics: of R = 0.66 eight miss
5·10⁻⁵, and of a response no more than a part in a hundred."""


def solve_discrete_ordinates(
    optics: xr.Dataset | Sequence[xr.Dataset],
    incidence_deg: float | str = 0.0,
    streams: int = 32,
    ground: Any = None,
) -> xr.Dataset:
    """Return what radiative transfer says about homogeneous layers, by discrete ordinates.

    Boundaries reflect nothing.  The phase function is cut at as many Legendre moments as there are
    streams, the rest of its forward peak is taken for unscattered (delta-M, Wiscombe 1977).

    Parameters
    ----------
    optics : xarray.Dataset, or sequence of them
        Of one layer, or of several, top first: from `splits.instruments.single_scattering`, with at
        least `streams` moments; or anything with its ``single_scattering_albedo``,
        ``optical_thickness`` and ``legendre_moment``.
    incidence_deg : float or "diffuse"
        Polar angle of a beam, 0 to 89.99 degrees, or equal radiance from everywhere.
    streams : int
        Directions of the solution, both hemispheres together: even, at least 4.
    ground : number, str, mapping or path, optional
        Lambertian ground below, see `splits.media.ground.Ground.from_input`; its part of the light
        counts as transmitted.

    Returns
    -------
    xarray.Dataset
        ``reflectance`` and ``transmittance`` (hemispherical; the latter with the direct beam) and
        ``absorptance`` over ``wavelength``; the ``…_truncation`` of each: its difference from the
        result with half the streams, an upper estimate of what the number of streams misses; and
        standard errors ``…_stderr``: that, and what errors of the optics make of it
        (`propagate_errors`), those of different layers being independent.  Albedos above
        `MAX_ALBEDO` are taken for that.

    Raises
    ------
    ImportError
        If PythonicDISORT is not installed (extra ``theory``).
    ValueError
        For a value outside its range or too few moments.

    References
    ----------
    Stamnes, Tsay, Wiscombe & Jayaweera (1988), Applied Optics 27, 2502; Ho (2024), PythonicDISORT,
    Journal of Open Source Software 9(103), 6442, doi:10.21105/joss.06442; Wiscombe (1977),
    Journal of the Atmospheric Sciences 34, 1408.
    """
    cosine = compute_incidence_cosine(incidence_deg)
    layers = [optics] if isinstance(optics, xr.Dataset) else list(optics)
    if not layers:
        raise invalid("optics", optics, "those of at least one layer")
    if isinstance(streams, bool) or streams % 2 or streams < 4:
        raise invalid("streams", streams, "an even number of at least 4")
    fewest = min(one.sizes["order"] for one in layers)
    if fewest <= streams:
        raise invalid("streams", streams, f"below the number of moments, {fewest}")
    below = Ground.from_input(ground)
    wavelengths = layers[0].wavelength.values
    for number, one in enumerate(layers):
        if not np.array_equal(one.wavelength.values, wavelengths):
            raise invalid(
                f"optics[{number}].wavelength", one.wavelength.values, "that of optics[0]"
            )
    albedo = np.zeros(wavelengths.shape) if below is None else below.albedo(wavelengths)
    fine, coarse = (_solve_stack(layers, cosine, n, albedo) for n in (streams, 2 * (streams // 4)))
    truncation = np.abs(fine - coarse)
    few = min(streams, N_RESPONSE_STREAMS)
    used = [_select_inputs(one).isel(order=slice(few + 1)) for one in layers]
    parts = []
    for i, one in enumerate(used):
        above, under = used[:i], used[i + 1 :]
        parts.append(
            propagate_errors(partial(_solve_with_layer, above, under, cosine, few, albedo), one)
        )
    stderr = np.sqrt(truncation**2 + sum(part**2 for part in parts))
    variables: dict[str, Variable] = {}
    for row, name in enumerate(("reflectance", "transmittance", "absorptance")):
        less = f"{name}_truncation"
        label = f"what the number of streams misses of {name}"
        variables |= make_variable(name, "wavelength", fine[row], stderr[row], name)
        variables |= make_variable(less, "wavelength", truncation[row], None, label)
    facts = {"theory": "discrete ordinates", "incidence_deg": incidence_deg, "streams": streams}
    facts |= describe_ground(below)
    return xr.Dataset(variables, {"wavelength": wavelengths}, facts)


def _solve_with_layer(
    layers_above: list[xr.Dataset],
    layers_below: list[xr.Dataset],
    cosine: float | None,
    streams: int,
    ground: np.ndarray,
    layer: xr.Dataset,
) -> np.ndarray:
    return _solve_stack([*layers_above, layer, *layers_below], cosine, streams, ground)


def _select_inputs(optics: xr.Dataset) -> xr.Dataset:
    return optics[[name for name in optics.data_vars if str(name).startswith(OPTICS_INPUTS)]]


def _import_solver() -> Callable[..., Any]:
    found = import_optional("PythonicDISORT", "theory", "discrete ordinates need")
    solver: Callable[..., Any] = found.pydisort
    return solver


def _solve_stack(
    layers: Sequence[xr.Dataset], cosine: float | None, streams: int, ground: np.ndarray
) -> np.ndarray:
    """Return reflectance, transmittance and absorptance, shape (3, wavelengths)."""
    thickness, albedo = (
        np.stack([one[name].values for one in layers], axis=-1)
        for name in ("optical_thickness", "single_scattering_albedo")
    )
    moments = np.stack(
        [
            one.legendre_moment.transpose("wavelength", "order").values[:, : streams + 1]
            for one in layers
        ],
        axis=1,
    )
    rows = zip(thickness, albedo, moments, ground, strict=True)
    found = np.array([_solve_wavelength(*row, cosine, streams) for row in rows])
    return np.concatenate([found.T, 1.0 - found.T.sum(axis=0, keepdims=True)])


def _solve_wavelength(
    thickness: np.ndarray,
    albedo: np.ndarray,
    moments: np.ndarray,
    ground: float,
    cosine: float | None,
    streams: int,
) -> tuple[float, float]:
    """Return hemispherical reflectance, and transmittance or what the ground keeps.

    Parameters
    ----------
    thickness, albedo : float, shape (layers,)
    moments : float, shape (layers, streams + 1)
    """
    # The library wants moments below 1 and a peak that is not negative, as noise may be.
    chi = np.clip(moments, -MAX_ALBEDO, MAX_ALBEDO)
    chi[:, 0] = 1.0
    beam = {"mu0": cosine, "I0": 1.0 / cosine} if cosine else {"mu0": 1.0, "I0": 0.0}
    depth = np.cumsum(thickness)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Some delta-scaled", UserWarning)
        _, up, down, *_ = _import_solver()(
            depth, np.minimum(albedo, MAX_ALBEDO), streams, chi,
            phi0=0.0, only_flux=True, f_arr=np.maximum(chi[:, streams], 0.0),
            b_neg=0.0 if cosine else 1.0 / np.pi, **beam,
            BDRF_Fourier_modes=[ground] if ground > 0.0 else [],
        )  # fmt: skip
    diffuse, direct = down(float(depth[-1]))
    return float(up(0.0)), float((1.0 - ground) * (diffuse + direct))
