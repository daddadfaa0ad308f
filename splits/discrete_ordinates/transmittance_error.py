"""Relative errors of small transmittances.

The transmittance T of thick layers is an exponential of their thickness.  The errors of streams and
of optics therefore change its logarithm, in proportion to 1 + |ln T|, and combine

- truncation, the difference from twice as many streams at some wavelengths;
- the statistical error of the tables.  Light is attenuated at the rate √(3 (1 − ω) (1 − g)) per
  mean free path (Ishimaru 1978, Wave Propagation and Scattering in Random Media, section 9.1).  The
  errors of (1 − ω) and (1 − g) are independent, and the relative error of their ratio is known;
  this rate has half of it;
- for other grains, the scatter of ln T without each batch of the paths through them, and
  the bound for grains of finite extent;
- for wet media, the error of the balance between dry and wet pores.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splits.discrete_ordinates.adding import Budget
from splits.discrete_ordinates.grain_table import GrainTable
from splits.discrete_ordinates.granular_layers import GranularLayer
from splits.discrete_ordinates.granular_stack import (
    GranularStack,
    SpectrumSolution,
    choose_trial_wavelengths,
    find_similarity_error,
    solve_spectrum,
    spread_truncation,
)
from splits.discrete_ordinates.integrals import TINY
from splits.discrete_ordinates.replicates import compute_replicate_error, list_traced

OPTICS_SHARE = 0.5
"""Error of ln T, relative to 1 + |ln T|, over that of (1 − ω)/(1 − g)."""
BALANCE_ERROR = 1e-3
"""Error of ln T of wet snow, relative to 1 + |ln T|: the largest if light changes 3.5 % more often
between dry and wet pores, half of the difference of both estimates."""
SUFFICIENT_ERROR = 0.01
"""Ratio of the error of a reflectance to a transmittance, below which it is that of both."""


def solve_with_exponent_error(
    snowpack: GranularStack, cosines: np.ndarray, max_error: float
) -> SpectrumSolution:
    """Return the budget of light with the errors of small transmittances; see `solve_spectrum`."""
    solution = solve_spectrum(snowpack, cosines, max_error)
    transmittance = solution.budget.transmittance
    is_small = transmittance * SUFFICIENT_ERROR < solution.error[:, np.newaxis]
    if not (is_small & (transmittance > 0.0)).any():
        return solution
    error = _compute_exponent_error(snowpack, cosines, solution)
    return solution._replace(exponent_error=error)


def _compute_exponent_error(
    snowpack: GranularStack, cosines: np.ndarray, solution: SpectrumSolution
) -> np.ndarray:
    """Return the error of ln T relative to 1 + |ln T|, shape (wavelengths,)."""
    n_wavelengths = snowpack.ground.size
    trial = choose_trial_wavelengths(n_wavelengths)
    few = snowpack.select(trial)

    def get_logarithm(budget: Budget) -> np.ndarray:
        logarithm: np.ndarray = np.log(np.maximum(budget.transmittance, TINY))
        return logarithm

    def solve(layers: Sequence[GranularLayer]) -> np.ndarray:
        return get_logarithm(few._replace(layers=layers).solve(cosines, solution.n_streams))

    fine = get_logarithm(solution.trial.fine)
    changes = [np.abs(get_logarithm(solution.trial.coarse) - fine)]
    if list_traced(few.layers):
        changes.append(compute_replicate_error(few.layers, solve))
    relative = [(change / (1.0 + np.abs(fine))).max(axis=-1) for change in changes]
    spread = spread_truncation(np.sqrt(sum(np.square(relative))), trial, n_wavelengths)
    is_wet = snowpack.is_wet
    contrasts = [one.contrast for one in snowpack.layers if isinstance(one.grains, GrainTable)]
    optics = OPTICS_SHARE * find_similarity_error(contrasts[0], is_wet) if contrasts else 0.0
    extent = np.max([layer.compute_extent_bound() for layer in snowpack.layers], axis=0)
    balance = BALANCE_ERROR if is_wet else 0.0
    error: np.ndarray = np.sqrt(spread**2 + optics**2 + extent**2 + balance**2)
    return error
