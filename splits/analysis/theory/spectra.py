"""Theories of snow: asymptotic radiative transfer, discrete ordinates, and their errors.

Both theories assume point scatterers.  In the interpretations of the papers, a ray leaves a grain
at its exit point, and a grain that overlaps the last segment or a boundary is sampled again.  In
all interpretations, the boundaries of wet pores reflect light.  docs/theory/radiative-transfer.md
quantifies the effects.  Errors of single-scattering properties are propagated to the results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from numbers import Integral
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import as_1d_array, as_float_array
from splits.core.inputs import check_incidence
from splits.core.optional import import_optional
from splits.core.uncertainty import Variable, compute_jackknife_stderr, make_variable
from splits.core.validation import check_range, invalid
from splits.discrete_ordinates.adding import Boundary, Element, compute_budget, make_isotropic
from splits.discrete_ordinates.homogeneous_layer import LayerOptics, Streams, solve_slab
from splits.media.ground import Ground, describe_ground
from splits.simulation.deep_medium import effective_mean_free_path

JACKKNIFE_SUFFIX, BOUND_SUFFIX = "_jackknife", "_interpolation_error_bound"
"""Suffixes of the variables of `splits.single_scattering` for errors."""

TheoryFunction = Callable[[xr.Dataset], np.ndarray]
"""Function from optics to an array with wavelengths along the last axis."""


def propagate_errors(theory: TheoryFunction, optics: xr.Dataset) -> np.ndarray:
    """Return the standard error of a theory's results due to errors of its optics.

    The theory is applied to the optics with each batch of rays left out in turn (jackknife), which
    includes the correlations of albedo, moments and displacements.  The bound from interpolation
    between refractive indices is added.

    Parameters
    ----------
    theory : callable
        From a dataset like `optics` to float[…, wavelengths].
    optics : xarray.Dataset
        From `splits.single_scattering`; without ``…_jackknife`` and
        ``…_interpolation_error_bound`` it is assumed exact.

    References
    ----------
    Efron (1982), The Jackknife, the Bootstrap and Other Resampling Plans, chapter 3.
    """
    parts = compute_jackknife_results(theory, optics)
    statistical = 0.0 if parts is None else compute_jackknife_stderr(parts)
    return np.hypot(statistical, compute_interpolation_bound(theory, optics))


def compute_jackknife_results(theory: TheoryFunction, optics: xr.Dataset) -> np.ndarray | None:
    """Return a theory's results with each batch of rays left out, or None without batches."""
    names = _list_names_with_suffix(optics, JACKKNIFE_SUFFIX)
    values = []
    for batch in range(optics.sizes["batch"] if names else 0):
        parts = {name: optics[name + JACKKNIFE_SUFFIX].isel(batch=batch) for name in names}
        values.append(theory(optics.assign(parts)))
    return np.stack(values) if values else None


def compute_interpolation_bound(theory: TheoryFunction, optics: xr.Dataset) -> np.ndarray:
    """Return the bound on the error of a theory's results due to interpolation of the optics.

    The absolute effects of the errors of all optical quantities are added, which is a bound if the
    results depend linearly on them.
    """
    if not _list_names_with_suffix(optics, BOUND_SUFFIX):
        return np.zeros(optics.sizes["wavelength"])
    result = theory(optics)
    bound = np.zeros_like(result)
    for name in _list_names_with_suffix(optics, BOUND_SUFFIX):
        if name in optics:
            for error in _iterate_components(optics[name + BOUND_SUFFIX]):
                bound += np.abs(theory(optics.assign({name: optics[name] - error})) - result)
    return bound


def _iterate_components(bound: xr.DataArray) -> Iterator[xr.DataArray]:
    """Yield a bound with a single order each, all others 0, since wavelengths are independent."""
    order_dims = [dim for dim in bound.dims if dim != "wavelength"]
    for index in np.ndindex(*(bound.sizes[dim] for dim in order_dims)):
        selection = dict(zip(order_dims, index, strict=True))
        if bound[selection].values.any():
            component = xr.zeros_like(bound)
            component[selection] = bound[selection]
            yield component


def _list_names_with_suffix(optics: xr.Dataset, suffix: str) -> list[str]:
    return [
        str(name).removesuffix(suffix) for name in optics.data_vars if str(name).endswith(suffix)
    ]


EXTRAPOLATION_LENGTH = 1.072
"""Extrapolation length of a half-space times 3/2, see `kz04`."""


def correct_dense_packing(optics: xr.Dataset) -> xr.Dataset:
    """Return optics with an optical thickness corrected for path lengths inside grains.

    Radiative transfer has path lengths between grains only, while rays of the model also advance
    inside grains: see `splits.simulation.deep_medium.effective_mean_free_path`.

    Parameters
    ----------
    optics : xarray.Dataset
        From `splits.single_scattering`.

    Returns
    -------
    xarray.Dataset
        A copy with corrected ``extinction`` and ``optical_thickness``, and their standard errors
        ``…_stderr``.  The optical thickness remains proportional to depth.
    """
    ratio = _compute_packing_ratio(optics)
    jackknife, bound = (
        compute_jackknife_results(_compute_packing_ratio, optics),
        compute_interpolation_bound(_compute_packing_ratio, optics),
    )
    error = propagate_errors(_compute_packing_ratio, optics)
    variables: dict[str, Any] = {}
    for name in {"extinction", "optical_thickness"} & {*optics}:
        value, label = optics[name].values, f"{name.replace('_', ' ')}, paths in grains included"
        units = optics[name].attrs.get("units", "1")
        variables |= make_variable(name, "wavelength", value * ratio, value * error, label, units)
        variables[name + BOUND_SUFFIX] = ("wavelength", value * bound)
        if jackknife is not None:
            variables[name + JACKKNIFE_SUFFIX] = (("batch", "wavelength"), value * jackknife)
    return optics.assign(variables)


def _compute_packing_ratio(optics: xr.Dataset) -> np.ndarray:
    """Return the ratio of the mean distance between grains to that of `correct_dense_packing`."""
    return 1.0 / optics.extinction.values / effective_mean_free_path(optics)


def kz04(
    wavelength_nm: Any,
    ssa_m2_kg: float,
    incidence_deg: float | str = 0.0,
    *,
    extinction_coefficient: Any = "p2016",
    absorption_enhancement: Any = 1.6,
    asymmetry: Any = 0.845,
    density_kg_m3: float = 300.0,
    depth_m: float = np.inf,
) -> xr.Dataset:
    """Return reflectance and transmittance of dry snow by asymptotic theory (`snowoptics`).

    Reflectance of a half-space by `snowoptics.albedo_KZ04`, R∞ = exp(−y u), with y² =
    16 (1 − ω)/(3 (1 − g)) and u = 3/7 (1 + 2 cosθ), 1 under diffuse light; a finite layer of
    transport thickness x = √(3 (1 − ω)(1 − g)) τ has

        T = u sinh(y) / sinh(x + 1.072 y),    R = R∞ − T exp(−x − y).

    It is valid for weak absorption (small k d, R above about 0.6) and, if finite, τ (1 − g) > 1.

    Parameters
    ----------
    wavelength_nm : array_like
        Vacuum wavelengths (nm).
    ssa_m2_kg : float
        Specific surface area (m²/kg), see `splits.Snow.specific_surface_area_m2_kg`.
    incidence_deg : float or "diffuse"
        Polar angle of a beam, 0 to 89.9999 degrees, or isotropic diffuse light.
    extinction_coefficient : array_like or str
        k of ice at the wavelengths, or the name of one of the package's datasets.
    absorption_enhancement, asymmetry : float or array_like
        Shape factors B and g with diffraction; the defaults are those of snowoptics, fitted to
        natural snow.  `compute_shape_factors` gives those of a medium.
    density_kg_m3 : float
        Density of the snow, for a finite depth.
    depth_m : float
        Depth above 0 (m), which may be infinite.

    Returns
    -------
    xarray.Dataset
        ``reflectance`` and ``transmittance`` over ``wavelength``.

    References
    ----------
    Kokhanovsky & Zege (2004), Applied Optics 43, 1589, doi:10.1364/AO.43.001589; for the finite
    layer Kokhanovsky & Nauss (2006), Atmospheric Chemistry and Physics 6, 5537; B and g from
    Libois et al. (2013), The Cryosphere 7, 1803.
    """
    snowoptics = import_optional("snowoptics", "theory", "analytical theories need")
    cosine = compute_incidence_cosine(incidence_deg)
    ssa = check_range("ssa_m2_kg", ssa_m2_kg, 0.0, np.inf, "m2/kg", open_low=True)
    if depth_m != np.inf:
        check_range("depth_m", depth_m, 0.0, np.inf, "m", open_low=True)
    wavelengths = as_1d_array("wavelength_nm", wavelength_nm, "numbers in nanometres")
    wavelength_m = wavelengths * 1e-9
    ni = extinction_coefficient
    if not isinstance(ni, str):
        ni = np.broadcast_to(as_float_array("extinction_coefficient", ni), wavelength_m.shape)
    shape = {"ni": ni, "B": absorption_enhancement, "g": asymmetry}
    half_space = snowoptics.albedo_KZ04(
        wavelength_m, np.arccos(cosine or 1.0), ssa, r_difftot=float(cosine is None), **shape
    )
    # The formula is singular at y = 0, where its limit is finite.
    y = np.maximum(np.sqrt(snowoptics.compute_alpha(wavelength_m, ssa, **shape)), 1e-9)
    # From snowoptics' own extinction, ρ SSA/2, and y: x/y = 3/4 (1 − g) τ.
    x = 0.0
    transmittance = np.zeros_like(y)
    if depth_m != np.inf:
        x = 0.75 * (1.0 - np.asarray(asymmetry)) * 0.5 * density_kg_m3 * ssa * depth_m * y
        escape = 1.0 if cosine is None else 3.0 / 7.0 * (1.0 + 2.0 * cosine)
        # sinh y / sinh(x + 1.072 y), without overflow.
        lower = x + EXTRAPOLATION_LENGTH * y
        transmittance = escape * np.exp(y - lower) * np.expm1(-2.0 * y) / np.expm1(-2.0 * lower)
    reflectance = half_space - transmittance * np.exp(-x - y)
    return xr.Dataset(
        {
            "reflectance": ("wavelength", reflectance),
            "transmittance": ("wavelength", transmittance),
        },
        {"wavelength": wavelengths},
        {"theory": "Kokhanovsky & Zege (2004)", "incidence_deg": incidence_deg},
    )


def compute_shape_factors(
    optics: xr.Dataset, ssa_m2_kg: float, extinction_coefficient: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return the absorption enhancement B and the asymmetry g of a medium with diffraction.

    With them, `kz04` has the (1 − ω)/(1 − g) of the medium.  B is constant for weak absorption.
    Smooth ice spheres have B = 1.25 and g = 0.89.

    Parameters
    ----------
    optics : xarray.Dataset
        From `splits.single_scattering`, of a dry medium.
    ssa_m2_kg : float
        Specific surface area (m²/kg).
    extinction_coefficient : array_like
        k of ice at the wavelengths, above 0.
    """
    gamma = 4.0 * np.pi * np.asarray(extinction_coefficient) / (optics.wavelength.values * 1e-9)
    coalbedo = 1.0 - optics.single_scattering_albedo.values
    # snowoptics: 1 − ω' = 2 B γ/(SSA ρ) with ρ = 917 kg/m³, and diffraction halves 1 − ω.
    return 0.25 * coalbedo * ssa_m2_kg * 917.0 / gamma, 0.5 * (
        1.0 + optics.asymmetry_parameter.values
    )


def compute_incidence_cosine(incidence_deg: float | str) -> float | None:
    """Return the cosine of incidence, or None for diffuse light."""
    incidence = check_incidence("incidence_deg", incidence_deg)
    return None if isinstance(incidence, str) else float(np.cos(np.radians(incidence)))


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
        Optics of one layer, or of several, top first: from `splits.single_scattering`
        with at least `streams` moments, or a dataset with ``single_scattering_albedo``,
        ``optical_thickness`` and ``legendre_moment``.
    incidence_deg : float or "diffuse"
        Polar angle of a beam, 0 to 89.9999 degrees, or isotropic diffuse light.
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
    wavelengths = layers[0].wavelength.values
    for number, layer in enumerate(layers):
        key = f"optics[{number}]"
        if "optical_thickness" not in layer:
            hint = "give the medium a depth_m"
            raise invalid(key, "without optical_thickness", "of finite depth", hint)
        if not np.array_equal(layer.wavelength, wavelengths):
            raise invalid(f"{key}.wavelength", layer.wavelength.values, "that of optics[0]")
    min_moments = min(layer.sizes["order"] for layer in layers)
    is_whole = isinstance(streams, Integral) and not isinstance(streams, bool)
    if not is_whole or streams % 2 or streams < 4:
        raise invalid("streams", streams, "an even number of at least 4")
    if streams >= min_moments:
        raise invalid("streams", streams, f"below the number of moments, {min_moments}")
    ground_model = Ground.from_input(ground)
    albedo = (
        np.zeros(wavelengths.shape) if ground_model is None else ground_model.albedo(wavelengths)
    )
    fine, coarse = (_solve_stack(layers, cosine, n, albedo) for n in (streams, 2 * (streams // 4)))
    truncation = np.abs(fine - coarse)
    n_response_streams = min(streams, N_RESPONSE_STREAMS)
    inputs = [
        layer[[name for name in layer.data_vars if str(name).startswith(OPTICS_INPUTS)]].isel(
            order=slice(n_response_streams + 1)
        )
        for layer in layers
    ]

    def solve_with(number: int, layer: xr.Dataset) -> np.ndarray:
        """Return the results with another layer of a number."""
        others = [*inputs[:number], layer, *inputs[number + 1 :]]
        return _solve_stack(others, cosine, n_response_streams, albedo)

    parts = [propagate_errors(partial(solve_with, i), layer) for i, layer in enumerate(inputs)]
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
