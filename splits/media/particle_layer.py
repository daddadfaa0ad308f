"""A scattering layer under a smooth or rough Fresnel surface, over a bottom (Budak & Grimailo)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from splits.core.arrays import read_columns
from splits.core.equality import ContentEquality
from splits.core.validation import (
    ROUNDING_TOLERANCE,
    as_scalar,
    check_choice,
    check_range,
    invalid,
    reject_unknown_keywords,
    snap_to_limits,
)
from splits.kernels.optics.phase_function import (
    PhaseFunction,
    make_henyey_greenstein,
    make_rayleigh,
    make_tabulated,
)
from splits.kernels.particle_layer.scene import OPEN_BOTTOM, ScatteringLayer
from splits.kernels.rough_surface.realization import HeightFields
from splits.media.formatting import find_differences, format_call
from splits.media.rough_surface import RoughSurface

CLEARANCE_SIGMA = 8.0
"""Standard deviations of height that must fit between mean surface and bottom."""

SEMI_INFINITE_TRANSPORT_MFP = 40.0
"""Transport mean free paths that stand for infinity where nothing is absorbed: what another
bottom would change above has decayed by exp(−40) there."""

PHASE_FUNCTIONS = ("henyey_greenstein", "rayleigh")


@reject_unknown_keywords
@dataclass(frozen=True, eq=False, repr=False)
class ParticleLayer(ContentEquality):
    """A homogeneous layer of small particles in a transparent matrix.

    Parameters
    ----------
    optical_thickness : float
        Of extinction, 0 to 1e6 or infinite.
    single_scattering_albedo : float
        0 to 1.
    asymmetry : float
        Mean cosine of the scattering angle, −0.999 to 0.999 (Henyey–Greenstein).
    refractive_index : float
        Of the matrix relative to the medium above, 1 to 10.
    bottom_albedo : float or None
        Of a Lambertian bottom, 0 to 1; None lets light leave through a smooth lower face.
    surface : RoughSurface, mapping, sequence of mappings, optional
        The upper boundary's random height; default: smooth.
    phase_function : "henyey_greenstein", "rayleigh" or mapping
        ``{"cosine": […], "density": […]}`` tabulates one, linear in between.
    polarized : bool
        Follow the Stokes vector; light comes in unpolarized.
    max_polarization : float
        Largest degree of polarization of light scattered once, 0 to 1, of Henyey–Greenstein and
        tabulated functions (see `splits.kernels.optics.phase_function`).
    opaque : bool
        Nothing comes back from below the surface: particles and bottom do not count.
    depth_m : float
        Geometric thickness (m), 1e-9 to 1e6; of an infinite layer, its mean free path.

    Raises
    ------
    ValueError
        For a value outside its range; the message names key, value and range.

    Notes
    -----
    Transmitted light is what the bottom absorbs, or what leaves through the open face.

    References
    ----------
    Budak & Grimailo 2020, section 3.2.

    Examples
    --------
    >>> from splits import Layer
    >>> Layer(optical_thickness=2.0).extinction_per_m
    2.0
    """

    kind = "particle_layer"

    optical_thickness: float = 10.0
    single_scattering_albedo: float = 0.99
    asymmetry: float = 0.75
    refractive_index: float = 1.5
    bottom_albedo: float | None = 0.5
    surface: Any = None
    phase_function: Any = "henyey_greenstein"
    polarized: bool = False
    max_polarization: float = 1.0
    opaque: bool = False
    depth_m: float = 1.0

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        put("optical_thickness", as_scalar(self.optical_thickness))
        if isinstance(self.optical_thickness, str):
            raise invalid(
                "optical_thickness", self.optical_thickness, "a number from 0 to 1e+06",
                "or infinite: .inf in YAML, math.inf in Python",
            )  # fmt: skip
        if not (isinstance(self.optical_thickness, float) and self.optical_thickness == math.inf):
            put(
                "optical_thickness",
                check_range(
                    "optical_thickness", self.optical_thickness, 0.0, 1e6,
                    hint="or infinite: .inf in YAML, math.inf in Python",
                ),
            )  # fmt: skip
        for name, low, high in (
            ("single_scattering_albedo", 0.0, 1.0),
            ("asymmetry", -0.999, 0.999),
            ("refractive_index", 1.0, 10.0),
            ("max_polarization", 0.0, 1.0),
        ):
            put(name, check_range(name, getattr(self, name), low, high))
        put("depth_m", check_range("depth_m", self.depth_m, 1e-9, 1e6, "m"))
        if self.bottom_albedo is not None:
            put("bottom_albedo", check_range("bottom_albedo", self.bottom_albedo, 0.0, 1.0))
        for name in ("polarized", "opaque"):
            if not isinstance(getattr(self, name), (bool, np.bool_)):
                raise invalid(name, getattr(self, name), "true or false")
        put("_phase", self._make_phase_function())
        if self.surface is not None:
            put("surface", RoughSurface.from_input(self.surface))
            least = CLEARANCE_SIGMA * self.surface.rms_height_m
            finite = self.optical_thickness != math.inf and not self.opaque
            if self.depth_m < least and finite:
                raise invalid(
                    "depth_m", self.depth_m, f"at least {least:g} m",
                    f"{CLEARANCE_SIGMA:g} standard deviations of height must fit above the bottom",
                )  # fmt: skip

    def _make_phase_function(self) -> PhaseFunction:
        """Return the phase function, or refuse it."""
        given = self.phase_function
        if isinstance(given, Mapping):
            return _make_tabulated_phase(given, self.max_polarization)
        check_choice("phase_function", given, PHASE_FUNCTIONS)
        if given == "rayleigh":
            return make_rayleigh()
        return make_henyey_greenstein(self.asymmetry, self.max_polarization)

    def __repr__(self) -> str:
        """Return the layer on one line, as it was given."""
        return format_call("ParticleLayer", find_differences(self, type(self)()))

    @property
    def extinction_per_m(self) -> float:
        """Extinction coefficient (1/m), infinite below an opaque surface."""
        if self.opaque:
            return math.inf
        infinite = self.optical_thickness == math.inf
        return (1.0 if infinite else self.optical_thickness) / self.depth_m

    @property
    def kernel_phase_function(self) -> PhaseFunction:
        """The phase function as kernels take it."""
        phase: PhaseFunction = self._phase  # type: ignore[attr-defined]
        return phase

    def make_scattering_layer(self, analog: bool) -> ScatteringLayer:
        """Return the layer as kernels take it.

        An infinite layer that absorbs nothing sends all light back, after infinitely many
        scatterings on average; one of finite depth over a white bottom does the same in time.
        """
        depth, albedo = self.depth_m, self.single_scattering_albedo
        bottom = OPEN_BOTTOM if self.bottom_albedo is None else self.bottom_albedo
        if self.opaque:
            albedo, bottom = 0.0, 0.0
        elif self.optical_thickness == math.inf:
            depth = math.inf
            if albedo == 1.0:
                reach = max(1.0, 1.0 / (1.0 - self.kernel_phase_function.g))
                rough = 0.0 if self.surface is None else CLEARANCE_SIGMA * self.surface.rms_height_m
                depth, bottom = (
                    SEMI_INFINITE_TRANSPORT_MFP * reach / self.extinction_per_m + rough,
                    1.0,
                )
        return ScatteringLayer(
            depth, self.extinction_per_m, albedo, self.refractive_index, bottom, analog
        )

    def make_height_fields(self) -> HeightFields | None:
        """Return the rough surface as kernels take it, None where it is smooth."""
        if self.surface is None or self.surface.rms_height_m == 0.0:
            return None
        numbers: HeightFields = self.surface.make_height_fields()
        return numbers

    def list_materials(self) -> tuple[str, ...]:
        """Return the name of the one material of index arrays."""
        return ("matrix",)

    def list_interfaces(self) -> list[Any]:
        """Return none: the index is the same at all wavelengths."""
        return []

    def compute_refractive_indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return the refractive index, shape (wavelengths, 1)."""
        return np.full((np.size(wavelength_nm), 1), complex(self.refractive_index))

    def describe(self) -> dict[str, Any]:
        """Return all inputs under names fit for dataset attributes."""
        inputs = {f.name: getattr(self, f.name) for f in fields(self)}
        surface = inputs.pop("surface")
        rough = {} if surface is None else surface.describe()
        if isinstance(self.phase_function, Mapping):
            inputs["phase_function"] = "tabulated"
            inputs |= {f"phase_{key}": self.phase_function[key] for key in ("cosine", "density")}
        return {
            **inputs,
            "asymmetry": self.kernel_phase_function.g,
            "max_polarization": self.kernel_phase_function.max_polarization,
            "surface": "smooth" if surface is None else "rough",
            **{f"surface_{key}": value for key, value in rough.items()},
            "extinction_per_m": self.extinction_per_m,
        }


def _make_tabulated_phase(table: Mapping[str, Any], max_polarization: float) -> PhaseFunction:
    """Return a tabulated phase function, or refuse it."""
    allowed = "a mapping with equally long lists cosine and density"
    if set(table) != {"cosine", "density"}:
        raise invalid("phase_function", [str(key) for key in table], allowed)
    table = {key: table[key] for key in ("cosine", "density")}
    cosine, density = read_columns("phase_function", table)
    if cosine.shape != density.shape:
        raise invalid("phase_function", (cosine.shape, density.shape), allowed)
    if cosine.size < 2 or not np.allclose(
        cosine[[0, -1]], (-1.0, 1.0), rtol=ROUNDING_TOLERANCE, atol=0.0
    ):
        raise invalid("phase_function.cosine", cosine.tolist(), "increasing from -1 to 1")
    cosine[[0, -1]] = -1.0, 1.0
    if (np.diff(cosine) <= 0.0).any():
        raise invalid("phase_function.cosine", cosine.tolist(), "increasing from -1 to 1")
    density = snap_to_limits(density, 0.0, 1e100)
    good = (density >= 0.0).all() and (density <= 1e100).all()
    if not good or not density.max() > 1e-100:
        raise invalid("phase_function.density", density.tolist(), "0 to 1e100, not all of them 0")
    return make_tabulated(cosine, density, max_polarization)
