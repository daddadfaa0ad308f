"""Particle layer under a smooth or rough Fresnel surface, over a Lambertian bottom.

The model is that of Budak & Grimailo (2020).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np

from splits.core.arrays import check_increasing
from splits.core.equality import ContentEquality
from splits.core.keywords import reject_unknown_keywords
from splits.core.validation import (
    ROUNDING_TOLERANCE,
    as_scalar,
    check_choice,
    check_flag,
    check_range,
    format_limit,
    invalid,
    snap_to_limits,
)
from splits.kernels.phase_function import (
    PhaseFunction,
    make_henyey_greenstein,
    make_rayleigh,
    make_tabulated,
)
from splits.kernels.rough_surface.realization import HeightFields
from splits.kernels.scene import MATRIX
from splits.materials.csv_table import read_tabulated_function
from splits.media.formatting import find_differences, format_call
from splits.media.ground import Ground
from splits.media.medium import LayerBottom, ParticleMedium
from splits.media.rough_surface import RoughSurface
from splits.media.scattering_matrix import MAX_DENSITY, ScatteringMatrix, check_density

CLEARANCE_SIGMA = 8.0
"""Minimum distance between the mean surface and the bottom, in standard deviations of height."""

SEMI_INFINITE_TRANSPORT_MFP = 40.0
"""Depth that replaces infinity in a conservative layer, in transport mean free paths.

The influence of the bottom on the reflected light has decayed by exp(−40) there.
"""

MAX_OPTICAL_DISTANCE = 5e5
"""Optical thickness above which absorption at that distance from the light is negligible."""

MAX_DEPOLARIZATION = 6.0 / 7.0
"""Largest depolarization factor of small particles."""

PHASE_FUNCTIONS = ("henyey_greenstein", "rayleigh")


@reject_unknown_keywords
@dataclass(frozen=True, eq=False, repr=False)
class ParticleLayer(ContentEquality, ParticleMedium):
    """Homogeneous layer of small particles in a transparent matrix.

    The properties do not depend on wavelength.

    Parameters
    ----------
    optical_thickness : float
        Extinction optical thickness, 0 to 1e6 or infinite.
    single_scattering_albedo : float
        Single-scattering albedo, 0 to 1.
    asymmetry : float
        Mean cosine of the scattering angle, −0.999 to 0.999 (Henyey–Greenstein).
    refractive_index : float
        Refractive index of the matrix relative to the medium above, 1 to 10.
    bottom_albedo : float or None
        Albedo of a Lambertian bottom, 0 to 1.  With None, light leaves through a smooth lower
        boundary.
    surface : RoughSurface, mapping or sequence of mappings, optional
        Random height field of the upper boundary; smooth by default.
    phase_function : {"henyey_greenstein", "rayleigh"} or mapping
        Phase function; a mapping ``{"cosine": […], "density": […]}`` tabulates one, with linear
        interpolation.
    scattering_matrix : mapping, pandas.DataFrame, xarray.Dataset or path, optional
        Scattering matrix of the particles, in place of `phase_function`: columns ``angle_deg, P11,
        P12, P33, P34`` and, where they differ from P11 and P33, ``P22, P44``, or expansion
        coefficients ``alpha1, alpha2, alpha3, alpha4, beta1, beta2`` by order; see
        `splits.media.scattering_matrix`.
    depolarization : float
        Depolarization factor of Rayleigh scattering, 0 to 6/7: the ratio of the intensities
        parallel and perpendicular to the plane of scattering at 90°, for unpolarized light.
    polarized : bool
        Whether polarization is simulated (the Stokes vector of each ray).  A tabulated phase
        function needs a `scattering_matrix` for this; that of Henyey and Greenstein is combined
        with the polarization of Rayleigh scattering.
    opaque : bool
        Whether all light transmitted by the surface is absorbed; particles and bottom then have
        no effect.
    depth_m : float
        Geometric thickness (m), 1e-9 to 1e6.  For an infinite optical thickness, it is the mean
        free path.

    Raises
    ------
    ValueError
        For a value outside its range; the message names key, value and range.

    Notes
    -----
    Transmittance counts the light absorbed by the bottom or, without a bottom, the light that
    leaves through the lower boundary.

    References
    ----------
    Budak & Grimailo 2020, section 3.2.

    Examples
    --------
    >>> from splits import ParticleLayer
    >>> ParticleLayer(optical_thickness=2.0).extinction_per_m
    2.0
    """

    kind = "particle_layer"
    wet_fraction = 1.0
    largest_grain_m = 0.0

    optical_thickness: float = 10.0
    single_scattering_albedo: float = 0.99
    asymmetry: float = 0.75
    refractive_index: float = 1.5
    bottom_albedo: float | None = 0.5
    surface: Any = None
    phase_function: Any = "henyey_greenstein"
    scattering_matrix: Any = None
    depolarization: float = 0.0
    polarized: bool = False
    opaque: bool = False
    depth_m: float = 1.0

    def __post_init__(self) -> None:
        put = partial(object.__setattr__, self)
        thickness = as_scalar(self.optical_thickness)
        hint = "or infinite: .inf in YAML, math.inf in Python"
        if isinstance(thickness, str):
            raise invalid("optical_thickness", thickness, "a number from 0 to 1e+06", hint)
        if not (isinstance(thickness, float) and thickness == math.inf):
            thickness = check_range("optical_thickness", thickness, 0.0, 1e6, hint=hint)
        put("optical_thickness", thickness)
        for name, low, high in (
            ("single_scattering_albedo", 0.0, 1.0),
            ("asymmetry", -0.999, 0.999),
            ("refractive_index", 1.0, 10.0),
            ("depolarization", 0.0, MAX_DEPOLARIZATION),
        ):
            put(name, check_range(name, getattr(self, name), low, high))
        put("depth_m", check_range("depth_m", self.depth_m, 1e-9, 1e6, "m"))
        if self.bottom_albedo is not None:
            put("bottom_albedo", check_range("bottom_albedo", self.bottom_albedo, 0.0, 1.0))
        for name in ("polarized", "opaque"):
            put(name, check_flag(name, getattr(self, name)))
        if self.scattering_matrix is not None:
            put("scattering_matrix", ScatteringMatrix.from_input(self.scattering_matrix))
            phase = self.scattering_matrix.make_phase_function()
        elif isinstance(self.phase_function, Mapping):
            if self.polarized:
                hint = "a phase function alone does not determine polarization"
                raise invalid("polarized", True, "with scattering_matrix", hint)
            phase = _make_tabulated_phase(self.phase_function)
        elif check_choice("phase_function", self.phase_function, PHASE_FUNCTIONS) == "rayleigh":
            phase = make_rayleigh(self.depolarization)
        else:
            phase = make_henyey_greenstein(self.asymmetry)
        put("_phase", phase)
        if self.surface is not None:
            put("surface", RoughSurface.from_input(self.surface))
            min_depth_m = CLEARANCE_SIGMA * self.surface.rms_height_m
            has_bottom = not (self.is_semi_infinite or self.opaque)
            if self.depth_m < min_depth_m and has_bottom:
                raise invalid(
                    "depth_m", self.depth_m,
                    f"at least {format_limit(min_depth_m, self.depth_m)} m",
                    f"{CLEARANCE_SIGMA:g} standard deviations of height must fit above the bottom",
                )  # fmt: skip

    def __repr__(self) -> str:
        """Return the call that constructs the layer, on one line."""
        return format_call("ParticleLayer", find_differences(self, type(self)()))

    @property
    def is_semi_infinite(self) -> bool:
        """Whether the optical thickness is infinite; the depth is then the mean free path."""
        return self.optical_thickness == math.inf

    @property
    def material_columns(self) -> dict[str, int]:
        """Column of the matrix, which may absorb."""
        return {"matrix": MATRIX}

    @property
    def extinction_per_m(self) -> float:
        """Extinction coefficient (1/m); infinite for an opaque layer."""
        if self.opaque:
            return math.inf
        return (1.0 if self.is_semi_infinite else self.optical_thickness) / self.depth_m

    @property
    def kernel_phase_function(self) -> PhaseFunction:
        """Phase function in the form the kernels take."""
        phase: PhaseFunction = self._phase  # type: ignore[attr-defined]
        return phase

    @property
    def scene_bottom(self) -> LayerBottom:
        """Lower end of the layer in a scene.

        An infinite conservative layer reflects all light, after an infinite mean number of
        scatterings.  A deep finite layer over a white bottom replaces it, with the same
        reflectance at finite cost.
        """
        if self.opaque or not self.is_semi_infinite:
            return LayerBottom(self.depth_m, self.bottom_albedo)
        if self.single_scattering_albedo < 1.0:
            return LayerBottom(math.inf, self.bottom_albedo)
        clearance_m = 0.0 if self.surface is None else CLEARANCE_SIGMA * self.surface.rms_height_m
        return LayerBottom(self.compute_truncation_depth(clearance_m), 1.0)

    def compute_truncation_depth(self, undisturbed_depth_m: float) -> float:
        """Return a depth (m), instead of an infinite one, over a white bottom.

        The light above the undisturbed depth (m) is that in the infinite layer.
        """
        albedo, g = self.single_scattering_albedo, self.kernel_phase_function.g
        rate = min(1.0, math.sqrt(3.0 * (1.0 - albedo) * (1.0 - albedo * g)))
        # The effect of a white bottom at a distance z from the light is at most exp(-2 rate z).
        optical_distance = SEMI_INFINITE_TRANSPORT_MFP * max(1.0, 1.0 / (1.0 - g))
        if rate > 0.0:
            decay = min(0.5 * SEMI_INFINITE_TRANSPORT_MFP / rate, MAX_OPTICAL_DISTANCE)
            optical_distance = max(optical_distance, decay)
        return undisturbed_depth_m + optical_distance / self.extinction_per_m

    def truncate(self, depth_m: float, ground: Ground | None) -> ParticleLayer:
        """Return a layer of another depth (m), over a ground of constant albedo as its bottom."""
        bottom_albedo = None if ground is None else ground.albedo_values[0]
        thickness = self.extinction_per_m * depth_m
        return replace(
            self, optical_thickness=thickness, depth_m=depth_m, bottom_albedo=bottom_albedo
        )

    def make_height_fields(self) -> HeightFields | None:
        """Return the rough surface in the form the kernels take, or None for a smooth surface."""
        if self.surface is None or self.surface.rms_height_m == 0.0:
            return None
        surface: RoughSurface = self.surface
        return surface.make_height_fields()

    def list_materials(self) -> tuple[str, ...]:
        """Return the names of the materials: that above the layer, and the matrix."""
        return ("air", "matrix")

    def list_interfaces(self) -> list[Any]:
        """Return no interfaces: the refractive index does not depend on wavelength."""
        return []

    def compute_refractive_indices(self, wavelength_nm: np.ndarray) -> np.ndarray:
        """Return complex refractive indices, shape (wavelengths, 2)."""
        index = np.ones((np.size(wavelength_nm), 2), dtype=complex)
        index[:, MATRIX] = self.refractive_index
        return index

    def describe(self) -> dict[str, Any]:
        """Return all inputs as dataset attributes."""
        inputs = {f.name: getattr(self, f.name) for f in fields(self)}
        surface = inputs.pop("surface")
        surface_attrs = {} if surface is None else surface.describe()
        if isinstance(self.phase_function, Mapping):
            inputs["phase_function"] = "tabulated"
            inputs |= {f"phase_{key}": self.phase_function[key] for key in ("cosine", "density")}
        matrix = inputs.pop("scattering_matrix")
        if matrix is not None:
            inputs["phase_function"] = "scattering_matrix"
            inputs |= {f"matrix_{key}": column for key, column in matrix.as_input().items()}
        return {
            **inputs,
            "asymmetry": self.kernel_phase_function.g,
            "surface": "smooth" if surface is None else "rough",
            **{f"surface_{key}": value for key, value in surface_attrs.items()},
            "extinction_per_m": self.extinction_per_m,
        }


def _make_tabulated_phase(table: Mapping[str, Any]) -> PhaseFunction:
    """Return the validated tabulated phase function."""
    key = "phase_function"
    (cosine, density), _ = read_tabulated_function(key, table, ("cosine", "density"))
    if not np.allclose(cosine[[0, -1]], (-1.0, 1.0), rtol=ROUNDING_TOLERANCE, atol=0.0):
        raise invalid(f"{key}.cosine", cosine.tolist(), "increasing from -1 to 1")
    cosine[[0, -1]] = -1.0, 1.0
    check_increasing(f"{key}.cosine", cosine)
    density = snap_to_limits(density, 0.0, MAX_DENSITY)
    return make_tabulated(cosine, check_density(f"{key}.density", density))
