"""Posterior samples of a retrieval compared with an MCMC sampler, for a curved posterior."""

import emcee
import numpy as np
from chi2 import NEEDS_JIT
from formula_tables import W, evaluate_spectrum, make_snowlike_table

import splits
from splits.retrieval.forward_model import TableForwardModel, get_table_ranges
from splits.retrieval.measurement import Measurement
from splits.retrieval.state_vector import StateVector

SIZE, SOOT = "optical_radius_um", "impurities_ng_g.black_carbon"
FIXED = {"incidence_deg": 30.0}
N_WALKERS, N_STEPS, N_BURN_IN = 32, 3000, 500


@NEEDS_JIT
def test_quantiles_match_an_ensemble_sampler():
    """Scale, size and soot are correlated for visible wavelengths and a noise of 5 %."""
    w, table = W[:4], make_snowlike_table()
    measured, names = evaluate_spectrum(300.0, 20.0, w), [SIZE, SOOT, "scale"]
    ranges = {SIZE: (40.0, 2000.0), SOOT: (0.0, 1600.0), "scale": (0.8, 1.2)}
    result = splits.retrieve((w, measured), table, ranges, 0.05, fixed=FIXED)
    measurement = Measurement.from_input((w, measured), 0.05)
    model = TableForwardModel(
        table, measurement, StateVector.from_ranges(ranges, None, get_table_ranges(table)), FIXED
    )
    best = model.state_vector.to_coordinates(result.dataset.value.values)
    covariance = measurement.covariance + model.compute_error_covariance(best)
    lower = np.linalg.cholesky(covariance)

    def compute_log_probability(states):
        inside = ((states >= 0.0) & (states <= 1.0)).all(axis=1)
        misfit = model.evaluate(np.clip(states, 0.0, 1.0)) - measured
        log_probability = -0.5 * (np.linalg.solve(lower, misfit.T) ** 2).sum(axis=0)
        return np.where(inside, log_probability, -np.inf)

    sampler = emcee.EnsembleSampler(N_WALKERS, len(names), compute_log_probability, vectorize=True)
    sampler._random.seed(1)
    start = np.random.default_rng(1).random((N_WALKERS, len(names)))
    sampler.run_mcmc(start, N_STEPS)
    chain = sampler.get_chain(discard=N_BURN_IN)
    autocorrelation_time = sampler.get_autocorr_time(discard=N_BURN_IN, tol=0)
    states = model.state_vector.to_coordinates(result.dataset.draws.values)
    for i in range(len(names)):
        for probability in (0.16, 0.5, 0.84):
            quantile = np.quantile(chain[:, :, i], probability)
            fraction = float((states[:, i] <= quantile).mean())
            n_effective = 1.0 / (
                1.0 / result.dataset.attrs["effective_sample_size"]
                + autocorrelation_time[i] / (N_WALKERS * (N_STEPS - N_BURN_IN))
            )
            assert abs(fraction - probability) < 4.0 * np.sqrt(
                probability * (1.0 - probability) / n_effective
            ), names[i]
