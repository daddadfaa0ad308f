"""What a retrieval has found, in numbers and in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.optional import import_optional
from splits.core.parameter_names import describe_parameter
from splits.core.uncertainty import make_variable
from splits.io.netcdf import make_provenance, to_netcdf_attributes
from splits.retrieval.measurement import Measurement
from splits.retrieval.optimal_estimation import (
    ALTERNATIVE_CHI2,
    MAPEstimate,
    PosteriorSummary,
    compute_fit_degrees_of_freedom,
)
from splits.retrieval.posterior import MIN_EFFECTIVE_DRAWS, N_DRAWS, PosteriorDraws
from splits.retrieval.state_vector import SCALE, StateVector
from splits.simulation.attributes import make_wavelength_coordinate

QUANTILES = (0.025, 0.16, 0.5, 0.84, 0.975)
UNDETERMINED_FRACTION = 0.5
"""Part of the spread of what was known before from which on a parameter counts as not told."""
MIN_MISFIT_PROBABILITY = 0.01
"""Probability of so large a misfit below which the model does not follow the measurement."""
BOUND_DISTANCE = 0.01
"""Distance (coordinate) from the end of a range within which a value lies at it."""
MAX_NONLINEARITY = 1.0
"""Bend of light, in its noise, from which on errors by a straight line are rough."""
MAX_PRIOR_TENSION = 3.0
"""Standard deviations between prior and result from which they disagree."""


NOISE_GIVEN = "as given"


class RetrievalResult:
    """What a measurement tells.

    Parameters
    ----------
    dataset : xarray.Dataset
        See `splits.retrieve`.

    Attributes
    ----------
    dataset : xarray.Dataset
    """

    def __init__(self, dataset: xr.Dataset) -> None:
        self.dataset = dataset

    @property
    def values(self) -> dict[str, float]:
        """Medians by parameter."""
        found = self.dataset.quantiles.sel(quantile=0.5)
        return {str(p): float(found.sel(parameter=p)) for p in found.parameter.values}

    @property
    def stderr(self) -> dict[str, float]:
        """Standard deviations by parameter."""
        found = self.dataset.value_stderr
        return {str(p): float(found.sel(parameter=p)) for p in found.parameter.values}

    @property
    def constrained(self) -> dict[str, bool]:
        """Which parameters the measurement tells."""
        found = self.dataset.constrained
        return {str(p): bool(found.sel(parameter=p)) for p in found.parameter.values}

    @property
    def warnings(self) -> list[str]:
        """What is to be known before these numbers are used."""
        told = str(self.dataset.attrs["warnings"])
        return [] if told == "none" else told.split("; ")

    def __repr__(self) -> str:
        """Return every parameter with its error in a line, and what is to be known of them."""
        quantiles = self.dataset.quantiles
        lines = []
        for name in map(str, quantiles.parameter.values):
            low, middle, high = quantiles.sel(parameter=name, quantile=[0.16, 0.5, 0.84]).values
            unit = str(self.dataset.parameter_unit.sel(parameter=name).item())
            unit = {"1e-9": "ng/g", "um": "µm", "degree": "°", "m2 kg-1": "m²/kg"}.get(unit, unit)
            tail = f" {unit}" if unit != "1" else ""
            if not self.constrained[name]:
                tail += ", not told by the measurement"
            lines.append(f"{name} {middle:.4g} ({low:.4g} to {high:.4g}){tail}")
        about = self.dataset.attrs
        known = f"chi2 {about['chi2']:.4g} of {about['chi2_expected']:.4g}"
        unknown = f"rms {about['rmse']:.4g}, by which errors go, as no noise was told"
        lines.append(
            f"misfit: {known if about['noise'] == NOISE_GIVEN else unknown}; "
            f"{about['degrees_of_freedom']:.2f} degrees of freedom of signal, "
            f"{about['information_bits']:.1f} bits"
        )
        return "\n".join([*lines, *(f"! {line}" for line in self.warnings)])


class Solution(NamedTuple):
    """What a retrieval has found.

    Attributes
    ----------
    estimates : sequence of MAPEstimate
        Best first.
    posterior : Told
    draws : PosteriorDraws
    variance_inflation : float
        By so much variances were enlarged, as the misfit asks for.
    prior_tension : float, shape (parameters,)
        How far priors are from what the measurement says without them, in standard errors.
    forward_model_error : float, shape (n,)
        Standard errors of the table, or of runs, at the best end.
    alternatives : tuple of float, shape (parameters,)
        Coordinates of other answers.
    nonlinearity : float
        How far light is off a straight line a standard deviation away, in units of its noise.
    """

    estimates: Sequence[MAPEstimate]
    posterior: PosteriorSummary
    draws: PosteriorDraws
    variance_inflation: float
    prior_tension: np.ndarray
    forward_model_error: np.ndarray
    alternatives: tuple[np.ndarray, ...] = ()
    nonlinearity: float = 0.0


def make_result(
    state_vector: StateVector, measurement: Measurement, solution: Solution
) -> RetrievalResult:
    """Return what was found as a dataset."""
    (best, *_), told, draws, excess, _, off, *_ = solution
    names = list(state_vector.names)
    natural = state_vector.to_physical(draws.states)
    spread = draws.states.std(axis=0)
    before = np.sqrt(state_vector.prior_variance)
    determined = spread < UNDETERMINED_FRACTION * before
    noise = np.sqrt(np.diag(measurement.covariance))
    over, pair = ("parameter",), ("parameter", "other_parameter")
    with np.errstate(invalid="ignore"):
        related = np.nan_to_num(np.atleast_2d(np.corrcoef(draws.states, rowvar=False)))
    labels = [f"{name}: {describe_parameter(name)[0]}" for name in names]
    variables = {
        **make_variable(
            "value",
            over,
            state_vector.to_physical(best.state),
            natural.std(axis=0),
            "most probable value",
        ),
        **make_variable("mean", over, natural.mean(axis=0), None, "mean"),
        **make_variable(
            "constrained",
            over,
            determined.astype(np.int8),
            None,
            "1 where the measurement halves what was not known before",
        ),
        **make_variable(
            "quantiles",
            ("quantile", "parameter"),
            np.quantile(natural, QUANTILES, axis=0),
            None,
            "quantiles",
        ),
        **make_variable(
            "averaging_kernel",
            pair,
            told.averaging_kernel * before / before[:, np.newaxis],
            None,
            "averaging kernel, in units of what was not known before",
        ),
        **make_variable("correlation", pair, related, None, "correlation of coordinates"),
        **make_variable("draws", ("draw", "parameter"), natural, None, "draws from the posterior"),
        **make_variable("measured", "wavelength", measurement.values, noise, "measured"),
        **make_variable("fitted", "wavelength", best.modelled, off, "of the most probable value"),
    }
    facts: dict[str, Any] = {
        "title": "Retrieval",
        "rmse": float(np.sqrt(np.mean((best.modelled - measurement.values) ** 2))),
        "noise": NOISE_GIVEN if measurement.noise_known else "found from the misfit",
        "chi2": excess * best.chi2,
        "chi2_expected": len(best.modelled) - compute_fit_degrees_of_freedom(best, state_vector),
        "error_inflation": float(np.sqrt(excess)),
        "degrees_of_freedom": told.degrees_of_freedom,
        "information_bits": told.information_bits,
        "effective_sample_size": draws.n_effective,
        "warnings": "; ".join(_list_warnings(state_vector, solution, determined)) or "none",
        **make_provenance("retrieval"),
    }
    units = [describe_parameter(name)[1] if name != SCALE else "1" for name in names]
    axes = {
        "parameter": ("parameter", names, {"long_name": "parameter"}),
        "other_parameter": ("other_parameter", names, {"long_name": "parameter"}),
        "parameter_unit": ("parameter", units, {"long_name": "unit of the parameter"}),
        "parameter_label": ("parameter", labels, {"long_name": "parameter in words"}),
        "quantile": ("quantile", np.array(QUANTILES), {"long_name": "probability", "units": "1"}),
        "draw": ("draw", np.arange(N_DRAWS), {"long_name": "draw"}),
        "wavelength": make_wavelength_coordinate(measurement.wavelength_nm),
    }
    return RetrievalResult(xr.Dataset(variables, axes, to_netcdf_attributes(facts)))


def compute_prior_tension(
    state_vector: StateVector, state: np.ndarray, variance: np.ndarray
) -> np.ndarray:
    """Return how far priors are from a place that is told without them, in standard errors."""
    found: np.ndarray = np.abs(state - state_vector.prior_mean) / np.sqrt(
        state_vector.prior_sd**2 + variance
    )
    return found


def compute_variance_inflation(estimate: MAPEstimate, state_vector: StateVector) -> float:
    """Return by how much variances are to be enlarged so that the misfit is no surprise."""
    chi2 = import_optional("scipy.stats", "retrieval", "retrievals need").chi2

    left = max(len(estimate.modelled) - compute_fit_degrees_of_freedom(estimate, state_vector), 1.0)
    if chi2.sf(estimate.chi2, left) > MIN_MISFIT_PROBABILITY:
        return 1.0
    return estimate.chi2 / left


def _list_warnings(
    state_vector: StateVector, solution: Solution, determined: np.ndarray
) -> list[str]:
    """Return what is to be known of the numbers."""
    ends, told, draws, excess, tension, *_ = solution
    best, found = ends[0], []
    if excess > 1.0:
        found.append(
            f"the model does not follow the measurement within its noise: errors are enlarged by "
            f"{np.sqrt(excess):.3g}, and may still be too small"
        )
    untold = [name for name, known in zip(state_vector.names, determined, strict=True) if not known]
    if untold:
        found.append(f"not told by the measurement: {', '.join(untold)}")
    for name, off in zip(state_vector.names, tension, strict=True):
        if off > MAX_PRIOR_TENSION:
            found.append(f"{name}: prior and measurement are {off:.1f} standard deviations apart")
    for i, name in enumerate(state_vector.names):
        low, high = (
            float(state_vector.to_physical(np.full(len(state_vector.names), x))[i])
            for x in (0.0, 1.0)
        )
        if not (determined[i] or best.active_bounds[i]):
            continue
        if best.state[i] < BOUND_DISTANCE and low != 0.0:
            found.append(f"{name} lies at the low end of its range, {low:g}")
        if best.state[i] > 1.0 - BOUND_DISTANCE:
            found.append(f"{name} lies at the high end of its range, {high:g}")
    for other in [*(end.state for end in ends[1:2]), *solution.alternatives]:
        off = other - best.state
        if off @ np.linalg.solve(told.covariance, off) < ALTERNATIVE_CHI2:
            # Within the errors: no other answer.
            continue
        words = [
            f"{n} {v:.3g}"
            for n, v in zip(state_vector.names, state_vector.to_physical(other), strict=True)
        ]
        found.append(f"another answer is nearly as good: {', '.join(words)}")
    if solution.nonlinearity > MAX_NONLINEARITY:
        found.append(
            f"errors take reflectance to be linear in the coordinates, but a standard deviation "
            f"away it is off by {solution.nonlinearity:.1f} times the noise: take them as rough"
        )
    if draws.n_effective < MIN_EFFECTIVE_DRAWS:
        found.append(f"quantiles are rough, of {draws.n_effective:.0f} draws in effect")
    return found
