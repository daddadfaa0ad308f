"""Radiative transfer in layers above a ground by discrete ordinates."""

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
"""PythonicDISORT rejects an albedo of 1 and loses digits close to it.  At 1 − 10⁻⁹ fluxes are
accurate to 10⁻⁶, and an optical thickness of 1000 absorbs at most 10⁻⁵ too much."""

OPTICS_INPUTS = ("optical_thickness", "single_scattering_albedo", "legendre_moment")
"""Variables of the optics that discrete ordinates use."""

N_RESPONSE_STREAMS = 8
"""Streams for the response of results to errors of the optics.  With eight, the error at R = 0.66
is 5·10⁻⁵, and that of a response below one per cent."""


def solve_discrete_ordinates(
    optics: xr.Dataset | Sequence[xr.Dataset],
    incidence_deg: float | str = 0.0,
    streams: int = 32,
    ground: Any = None,
) -> xr.Dataset:
    """Return reflectance and transmittance of homogeneous layers by discrete ordinates.

    Boundaries do not reflect.  The phase function is truncated to as many Legendre moments as
    streams, and the rest of its forward peak counts as unscattered (delta-M, Wiscombe 1977).

    Parameters
    ----------
    optics : xarray.Dataset, or sequence of them
        Optics of one layer, or of several, top first: from `splits.instruments.single_scattering`
        with at least `streams` moments, or a dataset with ``single_scattering_albedo``,
        ``optical_thickness`` and ``legendre_moment``.
    incidence_deg : float or "diffuse"
        Polar angle of a beam, 0 to 89.99 degrees, or isotropic diffuse light.
    streams : int
        Number of streams in both hemispheres: even, at least 4.
    ground : number, str, mapping or path, optional
        Lambertian ground below, see `splits.media.ground.Ground.from_input`.  Light that it absorbs
        counts as transmitted.

    Returns
    -------
    xarray.Dataset
        ``reflectance`` and ``transmittance`` (hemispherical, including the direct beam) and
        ``absorptance`` over ``wavelength``; ``…_truncation`` of each, the difference from the
        result with half the streams and an upper estimate of the truncation error; and standard
        errors ``…_stderr``, which combine it with the propagated errors of the optics
        (`propagate_errors`), independent between layers.  Albedos are limited to `MAX_ALBEDO`.

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
    min_moments = min(layer.sizes["order"] for layer in layers)
    if min_moments <= streams:
        raise invalid("streams", streams, f"below the number of moments, {min_moments}")
    ground_model = Ground.from_input(ground)
    wavelengths = layers[0].wavelength.values
    for number, layer in enumerate(layers):
        if not np.array_equal(layer.wavelength.values, wavelengths):
            raise invalid(
                f"optics[{number}].wavelength", layer.wavelength.values, "that of optics[0]"
            )
    albedo = (
        np.zeros(wavelengths.shape) if ground_model is None else ground_model.albedo(wavelengths)
    )
    fine, coarse = (_solve_stack(layers, cosine, n, albedo) for n in (streams, 2 * (streams // 4)))
    truncation = np.abs(fine - coarse)
    n_response_streams = min(streams, N_RESPONSE_STREAMS)
    inputs = [_select_inputs(layer).isel(order=slice(n_response_streams + 1)) for layer in layers]
    parts = []
    for i, layer in enumerate(inputs):
        layers_above, layers_below = inputs[:i], inputs[i + 1 :]
        parts.append(
            propagate_errors(
                partial(
                    _solve_with_layer,
                    layers_above,
                    layers_below,
                    cosine,
                    n_response_streams,
                    albedo,
                ),
                layer,
            )
        )
    stderr = np.sqrt(truncation**2 + sum(part**2 for part in parts))
    variables: dict[str, Variable] = {}
    for row, name in enumerate(("reflectance", "transmittance", "absorptance")):
        truncation_name = f"{name}_truncation"
        label = f"truncation error of {name} due to the number of streams"
        variables |= make_variable(name, "wavelength", fine[row], stderr[row], name)
        variables |= make_variable(truncation_name, "wavelength", truncation[row], None, label)
    attributes = {
        "theory": "discrete ordinates",
        "incidence_deg": incidence_deg,
        "streams": streams,
    }
    attributes |= describe_ground(ground_model)
    return xr.Dataset(variables, {"wavelength": wavelengths}, attributes)


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
    module = import_optional("PythonicDISORT", "theory", "discrete ordinates need")
    solver: Callable[..., Any] = module.pydisort
    return solver


def _solve_stack(
    layers: Sequence[xr.Dataset], cosine: float | None, streams: int, ground: np.ndarray
) -> np.ndarray:
    """Return reflectance, transmittance and absorptance, shape (3, wavelengths)."""
    thickness, albedo = (
        np.stack([layer[name].values for layer in layers], axis=-1)
        for name in ("optical_thickness", "single_scattering_albedo")
    )
    moments = np.stack(
        [
            layer.legendre_moment.transpose("wavelength", "order").values[:, : streams + 1]
            for layer in layers
        ],
        axis=1,
    )
    rows = zip(thickness, albedo, moments, ground, strict=True)
    fluxes = np.array([_solve_wavelength(*row, cosine, streams) for row in rows])
    return np.concatenate([fluxes.T, 1.0 - fluxes.T.sum(axis=0, keepdims=True)])


def _solve_wavelength(
    thickness: np.ndarray,
    albedo: np.ndarray,
    moments: np.ndarray,
    ground: float,
    cosine: float | None,
    streams: int,
) -> tuple[float, float]:
    """Return hemispherical reflectance, and transmittance or absorption of the ground.

    Parameters
    ----------
    thickness, albedo : float, shape (layers,)
    moments : float, shape (layers, streams + 1)
    """
    # The library requires moments below 1 and a nonnegative peak, despite noise.
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
