"""Scattering matrix of particles as an input: elements over the scattering angle, or expansions.

The matrix is that of randomly oriented particles with a plane of symmetry: P11, P12 = P21, P22,
P33, P34 = −P43 and P44, of the Stokes vector (I, Q, U, V) with the scattering plane as reference;
P12 < 0 polarizes light perpendicular to that plane.  For P34 and V there are two conventions.  That
of this package (docs/theory/polarization.md) is P34 = Im(S2 S1*) with the amplitudes of Bohren &
Huffman (1983).  The opposite sign reverses V in results, and is wrong where interfaces reflect
light totally; libRadtran has it, so that P34 of its files is reversed here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from splits.core.arrays import (
    as_1d_array,
    as_float_array,
    check_array_range,
    check_increasing,
    read_columns,
)
from splits.core.equality import ContentEquality
from splits.core.paths import expand_path
from splits.core.validation import check_integer, invalid, join_names
from splits.io.netcdf import NETCDF_SUFFIXES, open_foreign
from splits.kernels.phase_function import PhaseFunction, make_tabulated
from splits.materials.csv_table import read_csv, to_columns
from splits.media.formatting import format_input

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
KEY = "scattering_matrix"
ALLOWED = (
    f"columns {ANGLE}, {', '.join(REQUIRED_ELEMENTS)} and perhaps P22, P44, or expansion "
    f"coefficients {', '.join(COEFFICIENTS)}, as a mapping, table or file (.csv, .nc)"
)
MATRIX_NETCDF_SUFFIXES = (*NETCDF_SUFFIXES, ".cdf")
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
            path = expand_path(value, KEY)
            if path.suffix.lower() in MATRIX_NETCDF_SUFFIXES:
                with open_foreign(KEY, path) as dataset:
                    columns = _select_variables(dataset.load())
            else:
                table = read_csv(KEY, path)
                columns = {name: table.get_numbers(name) for name in table.column_names}
        else:
            is_dataset = isinstance(value, xr.Dataset)
            columns = _select_variables(value) if is_dataset else to_columns(value)
        if not isinstance(columns, Mapping):
            raise invalid(KEY, value, ALLOWED)
        errors = np.zeros(1)
        if set(COEFFICIENTS) & set(columns):
            if set(columns) != set(COEFFICIENTS):
                raise invalid(KEY, sorted(map(str, columns)), join_names(COEFFICIENTS))
            rows = [as_1d_array(f"{KEY}.{name}", columns[name]) for name in COEFFICIENTS]
            if len({row.size for row in rows}) != 1 or not rows[0].size or rows[0][0] <= 0.0:
                found = dict(zip(COEFFICIENTS, [row.size for row in rows], strict=True))
                allowed = "lists of the same length from order 0 on, with alpha1 above 0"
                raise invalid(KEY, found, allowed)
            for name, row in zip(COEFFICIENTS, rows, strict=True):
                check_array_range(f"{KEY}.{name}", row, -MAX_DENSITY, MAX_DENSITY)
            matrix = cls(*sum_expansion(np.stack(rows)))
        else:
            stderr = {n.removesuffix(STDERR): columns[n] for n in columns if STDERR in n}
            matrix = cls(*_read_elements({n: c for n, c in columns.items() if STDERR not in n}))
            if stderr:
                errors = _read_elements({ANGLE: columns[ANGLE], **stderr})[1]
        p11, p12, p33, p34, p22, p44 = matrix.elements.T
        check_density(f"{KEY}.P11", p11)
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
                KEY, found, "a sum of matrices of single particles",
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
        for name, variable in columns.items():
            if variable.ndim != 1:
                hint = "select one: dataset.sel(wavelength=…)"
                raise invalid(f"{KEY}.{name}", f"over {variable.dims}", "of one wavelength", hint)
        return {name: variable.values for name, variable in columns.items()}
    theta, phase, n_angles = (
        # Rows shorter than the longest one end with fill values.
        as_float_array(
            f"{KEY}.{name}",
            dataset[name].transpose(
                ..., *(dim for dim in NETCDF_DIMS if dim in dataset[name].dims)
            ),
            allow_gaps=True,
        )
        for name in NETCDF_NAMES
    )
    shape = phase.shape[-2:]
    if phase.size != np.prod(shape):
        hint = "select one: dataset.isel(nlam=[0], nreff=[0])"
        raise invalid(KEY, f"of shape {phase.shape}", "one wavelength and one size", hint)
    if theta.size != phase.size or n_angles.size != shape[0]:
        found = {name: dataset[name].shape for name in NETCDF_NAMES}
        raise invalid(KEY, found, "theta and phase over nphamat and nthetamax, ntheta over nphamat")
    theta, phase = theta.reshape(shape), phase.reshape(shape)
    # A file with a fill value for whole numbers is read as floats.
    n_angles = np.array(
        [
            check_integer(f"{KEY}.ntheta", int(n) if n == n // 1 else n, 2, shape[1])
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
        raise invalid(KEY, sorted(map(str, columns)), ALLOWED, hint)
    arrays = dict(zip(given, read_columns(KEY, {n: columns[n] for n in given}), strict=True))
    for name, other in OPTIONAL_ELEMENTS.items():
        arrays.setdefault(name, arrays[other])
    angle = arrays[ANGLE]
    elements = [arrays[name] for name in ELEMENTS]
    if len({angle.size, *(one.size for one in elements)}) != 1:
        found = {name: arrays[name].size for name in given}
        raise invalid(KEY, found, "columns of the same length")
    direction = -1 if angle.size > 1 and angle[0] > angle[-1] else 1
    angle = check_increasing(f"{KEY}.{ANGLE}", angle[::direction])
    ends = (0.0, 180.0)
    if angle.size < 2 or not np.allclose(angle[[0, -1]], ends, rtol=0.0, atol=1e-3):
        raise invalid(f"{KEY}.{ANGLE}", angle[[0, -1]].tolist(), "from 0 to 180 degrees")
    return np.concatenate([[0.0], angle[1:-1], [180.0]]), np.stack(elements, axis=-1)[::direction]
