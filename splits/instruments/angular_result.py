"""Common result of the estimators of a goniophotometer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.instruments.angular_bins import (
    AngularBinTally,
    estimate_bin_brdf,
    estimate_bin_stokes,
)
from splits.instruments.angular_estimate import AngularEstimate
from splits.instruments.detector_tally import DetectorResult
from splits.instruments.next_event import StoppingRule
from splits.simulation.runner import Runner
from splits.simulation.spectral_nodes import IndexNodes
from splits.simulation.tally import Tally


class AngularResult(NamedTuple):
    """Result of an estimator: estimate, stop reason, rays, tallies, polarization.

    `undefined_variables` are variables that the estimator does not provide.
    """

    estimate: AngularEstimate
    stop_reason: str
    n_rays: int
    tallies: Sequence[Tally] = ()
    stokes: Mapping[str, tuple[np.ndarray, np.ndarray]] = MappingProxyType({})
    undefined_variables: tuple[str, ...] = ()


def make_angular_attributes(
    result: AngularResult, stopping_rule: StoppingRule, nodes: IndexNodes, runner: Runner
) -> dict[str, Any]:
    """Return the attributes of the estimator, its stop reason and its cost."""
    return {
        "relative_stderr": stopping_rule.relative_stderr,
        "max_rays": stopping_rule.max_rays,
        "degree": result.estimate.degree[stopping_rule.side],
        "stop_reason": result.stop_reason,
        "interpolation_error_bound": float(nodes.interpolation_bound.max()),
        "rays": result.n_rays,
        "ensembles": len(nodes.index),
        "kernel": runner.format_kernels(result.tallies) or "scalar",
    }


def count_traced_rays(tallies: Sequence[Tally]) -> int:
    """Return the number of rays traced."""
    return sum(stratum.n_rays for tally in tallies for stratum in tally.strata)


def from_detectors(detector_result: DetectorResult, wavelengths: np.ndarray) -> AngularResult:
    """Return the result of next-event estimation."""
    stokes = detector_result.to_stokes(len(wavelengths)) if detector_result.polarized else {}
    # Light that reaches the bottom has other angles than at detectors outside.
    undefined = () if detector_result.has_lower_side else ("btdf",)
    estimate = detector_result.to_angular_estimate(len(wavelengths))
    return AngularResult(
        estimate, detector_result.stop_reason, detector_result.n_rays, (), stokes, undefined
    )


def estimate_by_bins(
    runner: Runner, nodes: IndexNodes, absorption: np.ndarray, n_bins: tuple[int, int], n_rays: int
) -> AngularResult:
    """Trace a number of rays and count them in angular bins."""
    tallies = [
        AngularBinTally(number, indices, absorption, weights, n_bins, runner.tracer.stokes_columns)
        for number, (indices, weights) in enumerate(zip(nodes.index, nodes.weights, strict=True))
    ]
    rays_per_tally = -(-n_rays // len(tallies))
    runner.trace(
        [(tally, stratum, rays_per_tally) for tally in tallies for stratum in tally.strata],
        1.0,
        0.0,
    )
    estimate = estimate_bin_brdf(tallies, nodes.interpolation_bound)
    return AngularResult(
        estimate, "max_rays", count_traced_rays(tallies), tallies, estimate_bin_stokes(tallies)
    )


def relabel_for_diffuse_light(dataset: xr.Dataset) -> xr.Dataset:
    """Return a dataset with the quantities and terms for diffuse illumination."""
    relabelled = dataset
    if "btdf" in dataset:
        for suffix in ("", "_stderr"):
            relabelled = relabelled.assign(
                {f"transmittance_factor{suffix}": np.pi * relabelled[f"btdf{suffix}"]}
            )
    terms = {
        "reflectance_factor": "hemispherical-directional reflectance factor",
        "transmittance_factor": "hemispherical-directional transmittance factor",
        "reflectance": "bihemispherical reflectance",
        "transmittance": "bihemispherical transmittance",
    }
    for name, term in terms.items():
        if name in relabelled:
            attributes = {"long_name": term, "units": "1", "ancillary_variables": f"{name}_stderr"}
            relabelled[name].attrs = attributes
            relabelled[f"{name}_stderr"].attrs = {
                "long_name": f"standard error of {term}", "units": "1"
            }  # fmt: skip
    beam_quantities = ("brdf", "btdf", "specular_reflectance", "direct_transmittance")
    names = [name + suffix for name in beam_quantities for suffix in ("", "_stderr")]
    return relabelled.drop_vars([name for name in names if name in relabelled])
