"""Particle layer under a smooth or rough Fresnel surface, over a Lambertian ground.

The model is that of Budak & Grimailo (2020).

The scattering matrix of the particles is an input: elements over the scattering angle, or expansion
coefficients.  It is that of randomly oriented particles with a plane of symmetry: P11, P12 = P21,
P22, P33, P34 = −P43 and P44, of the Stokes vector (I, Q, U, V) with the scattering plane as
reference; P12 < 0 polarizes light perpendicular to that plane.  For P34 and V there are two
conventions.  That of this package (docs/theory/polarization.md) is P34 = Im(S2 S1*) with the
amplitudes of Bohren & Huffman (1983).  The opposite sign reverses V in results, and is wrong where
interfaces reflect light totally; libRadtran has it, so that P34 of its files is reversed here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import xarray as xr

from splits.core.arrays import (
    ContentEquality,
    as_1d_array,
    as_float_array,
    check_array_range,
    check_increasing,
    read_columns,
)
from splits.core.declarations import Quantity, declare_class
from splits.core.inputs import INFINITE_HINT
from splits.core.validation import (
    ROUNDING_TOLERANCE,
    check_choice,
    check_integer,
    check_relations,
    expand_path,
    format_limit,
    invalid,
    join_names,
    snap_to_limits,
)
from splits.io.netcdf import NETCDF_SUFFIXES, open_foreign
from splits.kernels.scattering_matrix import (
    PhaseFunction,
    make_henyey_greenstein,
    make_rayleigh,
    make_tabulated,
)
from splits.kernels.scene import MATRIX, HeightFields
from splits.materials.csv_table import read_csv, read_tabulated_function, to_columns
from splits.media.formatting import find_differences, format_call, format_input
from splits.media.ground import Ground, GroundInput, describe_ground
from splits.media.medium import LayerBottom, ParticleMedium
from splits.media.rough_surface import RoughSurface

# --------------------------------------------------------------------------------------------------
# Scattering matrix as a sum of Wigner functions.
#
# With the functions d^l_mn of the scattering angle, the elements are
#
#     P11 = Σ α1 d_00            P22 + P33 = Σ (α2 + α3) d_22        P12 = −Σ β1 d_02
#     P44 = Σ α4 d_00            P22 − P33 = Σ (α2 − α3) d_2,−2      P34 = −Σ β2 d_02
#
# (Mishchenko, Travis & Lacis 2002, Scattering, Absorption, and Emission of Light by Small
# Particles, section 4.11; de Haan, Bosma & Hovenier 1987, Astron. Astrophys. 183, 371, write the
# same sums with generalized spherical functions).

COEFFICIENTS = ("alpha1", "alpha2", "alpha3", "alpha4", "beta1", "beta2")
ANGLES_PER_ORDER = 40
"""Angles at which elements are tabulated, per order: the error of linear interpolation is below
1e-3 of the highest term."""
MIN_ANGLES, MAX_ANGLES = 361, 20_001


def sum_expansion(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return scattering angles (degrees) and the elements of the matrix there.

    Parameters
    ----------
    coefficients : float, shape (6, orders)
        See `COEFFICIENTS`; orders from 0 on.

    Returns
    -------
    angle_deg : float, shape (n,)
    elements : float, shape (n, 6)
        P11, P12, P33, P34, P22 and P44.
    """
    alpha1, alpha2, alpha3, alpha4, beta1, beta2 = coefficients
    n_angles = int(np.clip(ANGLES_PER_ORDER * alpha1.size + 1, MIN_ANGLES, MAX_ANGLES))
    angle = np.linspace(0.0, 180.0, n_angles)
    mu = np.cos(np.radians(angle))
    p11, p44 = _sum_functions(0, 0, mu, alpha1, alpha4)
    p12, p34 = _sum_functions(0, 2, mu, -beta1, -beta2)
    (total,) = _sum_functions(2, 2, mu, alpha2 + alpha3)
    (difference,) = _sum_functions(2, -2, mu, alpha2 - alpha3)
    p22, p33 = 0.5 * (total + difference), 0.5 * (total - difference)
    return angle, np.stack([p11, p12, p33, p34, p22, p44], axis=-1)


def _sum_functions(m: int, n: int, mu: np.ndarray, *coefficients: np.ndarray) -> np.ndarray:
    """Return sums of the functions d^l_mn over l, for |m| ≤ |n|, each with its coefficients.

    Functions of successive orders follow from the recurrence of Mishchenko et al. (2002), Eq. B.22.

    Parameters
    ----------
    m, n : int
    mu : float, shape (angles,)
        Cosines.
    *coefficients : float, shape (orders,)
        From order 0 on.

    Returns
    -------
    float, shape (sums, angles)
    """
    first = abs(n)
    orders = np.arange(coefficients[0].size + 1.0)
    above = np.maximum(orders, 1.0)
    root = np.sqrt(np.maximum((orders**2 - m**2) * (orders**2 - n**2), 0.0)) / above
    shift = m * n / (above * (orders + 1.0))
    scale = 0.5**first * math.sqrt(
        math.factorial(2 * first) / (math.factorial(abs(m - n)) * math.factorial(abs(m + n)))
    )
    low = np.zeros_like(mu)
    high = scale * (1.0 - mu) ** (abs(m - n) // 2) * (1.0 + mu) ** (abs(m + n) // 2)
    sums = np.zeros((len(coefficients), mu.size))
    for order in range(first, coefficients[0].size):
        for total, values in zip(sums, coefficients, strict=True):
            total += values[order] * high
        following = (2.0 * order + 1.0) * (mu - shift[order]) * high - root[order] * low
        low, high = high, following / root[order + 1]
    return sums


# --------------------------------------------------------------------------------------------------
# Scattering matrix of particles as an input: elements over the scattering angle, or expansions.

ANGLE = "angle_deg"
REQUIRED_ELEMENTS = ("P11", "P12", "P33", "P34")
OPTIONAL_ELEMENTS = {"P22": "P11", "P44": "P33"}
"""Elements that may be left out, and those that they then equal, as for spheres."""
ELEMENTS = (*REQUIRED_ELEMENTS, *OPTIONAL_ELEMENTS)
PHYSICAL_TOLERANCE = 2e-3
"""Relative violation of the inequalities of a matrix that rounded elements may have."""
STDERR = "_stderr"
N_STDERR = 5.0
"""Violation of the inequalities, in the largest standard error of an element at an angle, that
elements with errors may have."""
MIN_DENSITY, MAX_DENSITY = 1e-100, 1e100
"""Limits of the largest value of a phase function."""
MATRIX_KEY = "scattering_matrix"
ALLOWED_MATRIX = (
    f"columns {ANGLE}, {', '.join(REQUIRED_ELEMENTS)} and perhaps P22, P44, or expansion "
    f"coefficients {', '.join(COEFFICIENTS)}, as a mapping, table or file (.csv, .nc)"
)
NETCDF_DIMS = ("nphamat", "nthetamax")
NETCDF_NAMES = ("theta", "phase", "ntheta")
"""Variables of the netCDF files of libRadtran, whose matrix elements have the order `ELEMENTS`."""


@dataclass(frozen=True, eq=False, repr=False)
class ScatteringMatrix(ContentEquality):
    """Elements of a scattering matrix over the scattering angle.

    Attributes
    ----------
    angle_deg : float, shape (n,)
        Scattering angles (degrees), increasing from 0 to 180.
    elements : float, shape (n, 6)
        P11, P12, P33, P34, P22 and P44, in any unit: P11 is normalized.
    """

    angle_deg: np.ndarray
    elements: np.ndarray

    @classmethod
    def from_input(cls, value: Any) -> ScatteringMatrix:
        """Return the matrix for an input.

        Parameters
        ----------
        value : ScatteringMatrix, mapping, pandas.DataFrame, xarray.Dataset or path
            Columns ``angle_deg, P11, P12, P33, P34`` and, where they differ from P11 and P33,
            ``P22, P44``, perhaps with standard errors ``…_stderr``; or expansion coefficients, see
            the module; or a CSV file of one of them.  Datasets and netCDF
            files may have the form of libRadtran, of a single wavelength and size.

        Raises
        ------
        ValueError
            For missing columns, angles that do not reach from 0 to 180, or elements that are no
            scattering matrix.
        """
        if isinstance(value, cls):
            return value
        if isinstance(value, str | Path):
            path = expand_path(value, MATRIX_KEY)
            if path.suffix.lower() in (*NETCDF_SUFFIXES, ".cdf"):
                with open_foreign(MATRIX_KEY, path) as dataset:
                    columns = _select_variables(dataset.load())
            else:
                table = read_csv(MATRIX_KEY, path)
                columns = {name: table.get_numbers(name) for name in table.column_names}
        else:
            is_dataset = isinstance(value, xr.Dataset)
            columns = _select_variables(value) if is_dataset else to_columns(value)
        if not isinstance(columns, Mapping):
            raise invalid(MATRIX_KEY, value, ALLOWED_MATRIX)
        errors = np.zeros(1)
        if set(COEFFICIENTS) & set(columns):
            if set(columns) != set(COEFFICIENTS):
                raise invalid(MATRIX_KEY, sorted(map(str, columns)), join_names(COEFFICIENTS))
            given = {f"{MATRIX_KEY}.{name}": columns[name] for name in COEFFICIENTS}
            rows = [
                check_array_range(key, as_1d_array(key, one), -MAX_DENSITY, MAX_DENSITY)
                for key, one in given.items()
            ]
            if len({row.size for row in rows}) != 1 or rows[0][0] <= 0.0:
                found = dict(zip(COEFFICIENTS, [row.size for row in rows], strict=True))
                allowed = "lists of the same length from order 0 on, with alpha1 above 0"
                raise invalid(MATRIX_KEY, found, allowed)
            matrix = cls(*sum_expansion(np.stack(rows)))
        else:
            stderr = {n.removesuffix(STDERR): columns[n] for n in columns if STDERR in n}
            matrix = cls(*_read_elements({n: c for n, c in columns.items() if STDERR not in n}))
            if stderr:
                errors = _read_elements({ANGLE: columns[ANGLE], **stderr})[1]
        p11, p12, p33, p34, p22, p44 = matrix.elements.T
        check_density(f"{MATRIX_KEY}.P11", p11)
        allowance = PHYSICAL_TOLERANCE * p11 + N_STDERR * np.max(errors, axis=-1)
        # A matrix is a sum of matrices of single particles if its coherency matrix has no negative
        # eigenvalue (Cloude 1986, Optik 75, 26); these are its three blocks.
        is_physical = (
            (np.hypot(2.0 * p12, np.hypot(p33 + p44, 2.0 * p34)) <= p11 + p22 + allowance)
            & (np.abs(p33 - p44) <= p11 - p22 + allowance)
        )  # fmt: skip
        if not is_physical.all():
            first = int(np.argmin(is_physical))
            found = dict(zip(ELEMENTS, matrix.elements[first].tolist(), strict=True))
            raise invalid(
                MATRIX_KEY, found, "a sum of matrices of single particles",
                f"at {matrix.angle_deg[first]:g}°; elements are not divided by P11",
            )  # fmt: skip
        return matrix

    def as_input(self) -> dict[str, np.ndarray]:
        """Return the input of `from_input` for this matrix, as columns."""
        columns = dict(zip(ELEMENTS, self.elements.T, strict=True))
        return {ANGLE: self.angle_deg, **columns}

    def __repr__(self) -> str:
        """Return the call that constructs the matrix, on one line."""
        return f"ScatteringMatrix.from_input({format_input(self)})"

    def make_phase_function(self) -> PhaseFunction:
        """Return the matrix in the form the kernels take."""
        p11, p12, p33, p34, p22, p44 = self.elements.T
        # At angles without light, the elements are 0, too.
        scale = np.divide(1.0, p11, out=np.zeros_like(p11), where=p11 > 0.0)
        cosines = np.cos(np.radians(self.angle_deg))
        cosines[[0, -1]] = 1.0, -1.0
        ratios = np.stack([p12, p22, p33, p34, p44], axis=-1) * scale[:, np.newaxis]
        return make_tabulated(cosines, p11, ratios)


def check_density(key: str, values: np.ndarray) -> np.ndarray:
    """Return a phase function in any unit, checked for sums that overflow or lose all digits."""
    lowest, highest = float(values.min()), float(values.max())
    if not (lowest >= 0.0 and MIN_DENSITY <= highest <= MAX_DENSITY):
        allowed = "numbers from 0 to 1e100, one of them at least 1e-100"
        found = highest if lowest >= 0.0 else lowest
        raise invalid(key, found, allowed, "their unit is arbitrary")
    return values


def _select_variables(dataset: xr.Dataset) -> Mapping[str, Any]:
    """Return the columns of a dataset: its variables, or those of libRadtran."""
    if not set(NETCDF_NAMES) <= set(dataset.variables):
        names = [ANGLE, *ELEMENTS, *(f"{name}{STDERR}" for name in ELEMENTS), *COEFFICIENTS]
        columns = {str(name): dataset[name] for name in names if name in dataset.variables}
        allowed, hint = "of one wavelength", "select one: dataset.sel(wavelength=…)"
        check_relations(
            *(
                (one.ndim == 1, f"{MATRIX_KEY}.{name}", f"over {one.dims}", allowed, hint)
                for name, one in columns.items()
            )
        )
        return {name: variable.values for name, variable in columns.items()}
    theta, phase, n_angles = (
        # Rows shorter than the longest one end with fill values.
        as_float_array(
            f"{MATRIX_KEY}.{name}",
            dataset[name].transpose(
                ..., *(dim for dim in NETCDF_DIMS if dim in dataset[name].dims)
            ),
            allow_gaps=True,
        )
        for name in NETCDF_NAMES
    )
    shape = phase.shape[-2:]
    check_relations(
        (
            phase.size == np.prod(shape), MATRIX_KEY, f"of shape {phase.shape}",
            "one wavelength and one size", "select one: dataset.isel(nlam=[0], nreff=[0])",
        ),
        (
            theta.size == phase.size and n_angles.size == np.prod(shape[:1]), MATRIX_KEY,
            {name: dataset[name].shape for name in NETCDF_NAMES},
            "theta and phase over nphamat and nthetamax, ntheta over nphamat",
        ),
    )  # fmt: skip
    theta, phase = theta.reshape(shape), phase.reshape(shape)
    # A file with a fill value for whole numbers is read as floats.
    n_angles = np.array(
        [
            check_integer(f"{MATRIX_KEY}.ntheta", int(n) if n == n // 1 else n, 2, shape[1])
            for n in n_angles.ravel().tolist()
        ]
    )
    # Angles decrease or increase, and each element has its own.
    grid = theta[0, : n_angles[0]]
    elements = {ANGLE: grid}
    for name, row, angles, size in zip(ELEMENTS, phase, theta, n_angles, strict=False):
        order = np.argsort(angles[:size])
        values = np.interp(grid, angles[:size][order], row[:size][order])
        elements[name] = -values if name == "P34" else values
    return elements


def _read_elements(columns: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return the angles and the elements of columns, with angles increasing."""
    given = [name for name in (ANGLE, *ELEMENTS) if name in columns]
    missing = [name for name in (ANGLE, *REQUIRED_ELEMENTS) if name not in columns]
    unknown = sorted(set(map(str, columns)) - set(given))
    if missing or unknown:
        hint = f"missing {join_names(missing)}" if missing else f"unknown {join_names(unknown)}"
        raise invalid(MATRIX_KEY, sorted(map(str, columns)), ALLOWED_MATRIX, hint)
    arrays = dict(zip(given, read_columns(MATRIX_KEY, {n: columns[n] for n in given}), strict=True))
    for name, other in OPTIONAL_ELEMENTS.items():
        arrays.setdefault(name, arrays[other])
    angle = arrays[ANGLE]
    elements = [arrays[name] for name in ELEMENTS]
    if len({angle.size, *(one.size for one in elements)}) != 1:
        found = {name: arrays[name].size for name in given}
        raise invalid(MATRIX_KEY, found, "columns of the same length")
    direction = -1 if angle.size > 1 and angle[0] > angle[-1] else 1
    angle = check_increasing(f"{MATRIX_KEY}.{ANGLE}", angle[::direction])
    ends = (0.0, 180.0)
    if angle.size < 2 or not np.allclose(angle[[0, -1]], ends, rtol=0.0, atol=1e-3):
        raise invalid(f"{MATRIX_KEY}.{ANGLE}", angle[[0, -1]].tolist(), "from 0 to 180 degrees")
    return np.concatenate([[0.0], angle[1:-1], [180.0]]), np.stack(elements, axis=-1)[::direction]


# --------------------------------------------------------------------------------------------------
# Particle layer.

CLEARANCE_SIGMA = 8.0
"""Minimum distance between the mean surface and the ground, in standard deviations of height."""

SEMI_INFINITE_TRANSPORT_MFP = 40.0
"""Depth that replaces infinity in a conservative layer, in transport mean free paths.

The influence of the ground on the reflected light has decayed by exp(−40) there.
"""

MAX_OPTICAL_DISTANCE = 5e5
"""Optical thickness above which absorption at that distance from the light is negligible."""

MAX_DEPOLARIZATION = 6.0 / 7.0
"""Largest depolarization factor of small particles."""

OpticalThickness = Annotated[
    float,
    Quantity("optical thickness", low=0.0, high=1e6, infinite=True, hint=INFINITE_HINT),
]
SingleScatteringAlbedo = Annotated[
    float,
    Quantity("single-scattering albedo", low=0.0, high=1.0, scale=0.016, root_at=1.0),
]
Asymmetry = Annotated[
    float,
    Quantity("mean cosine of the scattering angle", low=-0.999, high=0.999, scale=0.16),
]
MatrixIndex = Annotated[float, Quantity("refractive index", low=1.0, high=10.0)]
Surface = Annotated[
    Any,
    Quantity(
        "surface of the layer",
        check=lambda _, value: None if value is None else RoughSurface.from_input(value),
        schema={"type": ["object", "array", "null"]},
    ),
]


PHASE_FUNCTIONS = ("henyey_greenstein", "rayleigh")
PhaseFunctionInput = Annotated[
    Any,
    Quantity(
        "phase function",
        check=lambda key, value: (
            value if isinstance(value, Mapping) else check_choice(key, value, PHASE_FUNCTIONS)
        ),
        schema={"anyOf": [{"enum": list(PHASE_FUNCTIONS)}, {"type": "object"}]},
    ),
]  # fmt: skip
ScatteringMatrixInput = Annotated[
    Any,
    Quantity(
        "scattering matrix",
        check=lambda _, value: None if value is None else ScatteringMatrix.from_input(value),
        schema={"type": ["object", "string", "null"]},
    ),
]
Depolarization = Annotated[
    float,
    Quantity("depolarization factor of Rayleigh scattering", low=0.0, high=MAX_DEPOLARIZATION),
]
Polarized = Annotated[bool, Quantity("whether the Stokes vector is traced")]
Opaque = Annotated[bool, Quantity("whether all light transmitted by the surface is absorbed")]
DEFAULT_GROUND = Ground("albedo 0.5", "default outside of stacks", np.array([0.5]))
"""Ground of a layer that is no part of a stack; its source differs from that of a given albedo."""
LayerThickness = Annotated[
    float, Quantity("thickness of the sample", "m", low=1e-9, high=1e6, label="depth")
]


@declare_class
class ParticleLayer(ContentEquality, ParticleMedium):
    """Homogeneous layer of small particles in a transparent matrix.

    The properties do not depend on wavelength, except those of the ground.

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
    ground : number, str, mapping or path, optional
        Lambertian ground in contact with the matrix: an albedo, "black", the name of a soil or a
        table; see `splits.media.ground.Ground.from_input`.  With "open" or None, light leaves
        through a smooth lower boundary.  The default is an albedo of 0.5; in a stack, a layer has
        no ground of its own.  No light reaches the ground of an infinite layer.
    surface : RoughSurface, mapping or sequence of mappings, optional
        Random height field of the upper boundary; smooth by default.
    phase_function : {"henyey_greenstein", "rayleigh"} or mapping
        Phase function; a mapping ``{"cosine": […], "density": […]}`` tabulates one, with linear
        interpolation.
    scattering_matrix : mapping, pandas.DataFrame, xarray.Dataset or path, optional
        Scattering matrix of the particles, in place of `phase_function`: columns ``angle_deg, P11,
        P12, P33, P34`` and, where they differ from P11 and P33, ``P22, P44``, or expansion
        coefficients ``alpha1, alpha2, alpha3, alpha4, beta1, beta2`` by order, see
        the module.
    depolarization : float
        Depolarization factor of Rayleigh scattering, 0 to 6/7: the ratio of the intensities
        parallel and perpendicular to the plane of scattering at 90°, for unpolarized light.
    polarized : bool
        Whether polarization is simulated (the Stokes vector of each ray).  A tabulated phase
        function needs a `scattering_matrix` for this; that of Henyey and Greenstein is combined
        with the polarization of Rayleigh scattering.
    opaque : bool
        Whether all light transmitted by the surface is absorbed; particles and ground then have
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
    Transmittance counts the light absorbed by the ground or, without a ground, the light that
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

    optical_thickness: OpticalThickness = 10.0
    single_scattering_albedo: SingleScatteringAlbedo = 0.99
    asymmetry: Asymmetry = 0.75
    refractive_index: MatrixIndex = 1.5
    ground: GroundInput = DEFAULT_GROUND
    surface: Surface = None
    phase_function: PhaseFunctionInput = "henyey_greenstein"
    scattering_matrix: ScatteringMatrixInput = None
    depolarization: Depolarization = 0.0
    polarized: Polarized = False
    opaque: Opaque = False
    depth_m: LayerThickness = 1.0

    def __post_init__(self) -> None:
        if self.scattering_matrix is not None:
            phase = self.scattering_matrix.make_phase_function()
        elif isinstance(self.phase_function, Mapping):
            if self.polarized:
                hint = "a phase function alone does not determine polarization"
                raise invalid("polarized", True, "with scattering_matrix", hint)
            key, columns = "phase_function", ("cosine", "density")
            (cosine, density), _ = read_tabulated_function(key, self.phase_function, columns)
            if not np.allclose(cosine[[0, -1]], (-1.0, 1.0), rtol=ROUNDING_TOLERANCE, atol=0.0):
                raise invalid(f"{key}.cosine", cosine.tolist(), "increasing from -1 to 1")
            cosine[[0, -1]] = -1.0, 1.0
            check_increasing(f"{key}.cosine", cosine)
            density = snap_to_limits(density, 0.0, MAX_DENSITY)
            phase = make_tabulated(cosine, check_density(f"{key}.density", density))
        elif self.phase_function == "rayleigh":
            phase = make_rayleigh(self.depolarization)
        else:
            phase = make_henyey_greenstein(self.asymmetry)
        object.__setattr__(self, "kernel_phase_function", phase)
        if self.surface is not None:
            min_depth_m = CLEARANCE_SIGMA * self.surface.rms_height_m
            is_reached = not (self.is_semi_infinite or self.opaque)
            if self.depth_m < min_depth_m and is_reached:
                raise invalid(
                    "depth_m", self.depth_m,
                    f"at least {format_limit(min_depth_m, self.depth_m)} m",
                    f"{CLEARANCE_SIGMA:g} standard deviations of height must fit above the ground",
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
    def scene_bottom(self) -> LayerBottom:
        """Lower end of the layer in a scene.

        An infinite conservative layer reflects all light, after an infinite mean number of
        scatterings.  A deep finite layer over a white ground replaces it, with the same
        reflectance at finite cost.
        """
        if self.opaque:
            return LayerBottom(self.depth_m, None)
        if not self.is_semi_infinite:
            return LayerBottom(self.depth_m, self.ground)
        if self.single_scattering_albedo < 1.0:
            return LayerBottom(math.inf, None)
        clearance_m = 0.0 if self.surface is None else CLEARANCE_SIGMA * self.surface.rms_height_m
        white = Ground.from_input(1.0)
        return LayerBottom(self.compute_truncation_depth(clearance_m), white)

    def compute_truncation_depth(self, undisturbed_depth_m: float) -> float:
        """Return a depth (m), instead of an infinite one, over a white ground.

        The light above the undisturbed depth (m) is that in the infinite layer.
        """
        albedo, g = self.single_scattering_albedo, self.kernel_phase_function.g
        rate = min(1.0, math.sqrt(3.0 * (1.0 - albedo) * (1.0 - albedo * g)))
        # The effect of a white ground at a distance z from the light is at most exp(-2 rate z).
        optical_distance = SEMI_INFINITE_TRANSPORT_MFP * max(1.0, 1.0 / (1.0 - g))
        if rate > 0.0:
            decay = min(0.5 * SEMI_INFINITE_TRANSPORT_MFP / rate, MAX_OPTICAL_DISTANCE)
            optical_distance = max(optical_distance, decay)
        return undisturbed_depth_m + optical_distance / self.extinction_per_m

    def truncate(self, depth_m: float, ground: Ground | None) -> ParticleLayer:
        """Return a layer of another depth (m), over a ground in contact with it."""
        thickness = self.extinction_per_m * depth_m
        return replace(self, optical_thickness=thickness, depth_m=depth_m, ground=ground)

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
        surface, ground = inputs.pop("surface"), inputs.pop("ground")
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
            **describe_ground(ground),
        }
