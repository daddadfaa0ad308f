"""Radiative transfer by discrete ordinates in layers of given optics above a ground."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from splits.analysis.theory.asymptotic import compute_incidence_cosine
from splits.analysis.theory.error_propagation import propagate_errors
from splits.core.uncertainty import Variable, make_variable
from splits.core.validation import invalid
from splits.discrete_ordinates.adding import Boundary, Element, compute_budget, make_isotropic
from splits.discrete_ordinates.homogeneous_layer import LayerOptics, Streams, solve_slab
from splits.media.ground import Ground, describe_ground

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
        (`propagate_errors`), independent between layers.

    Raises
    ------
    ValueError
        For a value outside its range or too few moments.

    References
    ----------
    Stamnes, Tsay, Wiscombe & Jayaweera (1988), Applied Optics 27, 2502; Wiscombe (1977), Journal
    of the Atmospheric Sciences 34, 1408.
    """
    cosine = compute_incidence_cosine(incidence_deg)
    layers = [optics] if isinstance(optics, xr.Dataset) else list(optics)
    if not layers:
        raise invalid("optics", optics, "those of at least one layer")
    for number, layer in enumerate(layers):
        if "optical_thickness" not in layer:
            hint = "give the medium a depth_m"
            raise invalid(f"optics[{number}]", "without optical_thickness", "of finite depth", hint)
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


def _solve_stack(
    layers: Sequence[xr.Dataset], cosine: float | None, n_streams: int, ground: np.ndarray
) -> np.ndarray:
    """Return reflectance, transmittance and absorptance, shape (3, wavelengths)."""
    streams = Streams.from_number(n_streams)
    cosines = np.array([] if cosine is None else [cosine])
    elements, isotropic = [], []
    for layer in layers:
        moments = layer.legendre_moment.transpose("wavelength", "order").values
        optics = LayerOptics.from_albedo(
            layer.optical_thickness.values,
            layer.single_scattering_albedo.values,
            moments[:, : n_streams + 1],
        )
        vector = make_isotropic(optics, streams, cosines.size)
        slab = solve_slab(optics.truncate(n_streams), streams, cosines[np.newaxis])
        elements.append(Element.from_slab(slab, vector))
        isotropic.append(vector)
    faces = (Boundary.make_transparent(n_streams // 2, cosines.size),) * 2
    budget = compute_budget(elements, (isotropic[0], isotropic[-1]), faces, ground, n_streams // 2)
    # The beam is first, and diffuse light alone where there is none.
    reflectance, transmittance = budget.reflectance[:, 0], budget.transmittance[:, 0]
    return np.stack([reflectance, transmittance, 1.0 - reflectance - transmittance])
