"""What the estimators of a goniophotometer found, in one form."""

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
from splits.instruments.next_event import DetectorResult, StoppingRule
from splits.simulation.runner import Runner
from splits.simulation.spectral_nodes import IndexNodes
from splits.simulation.tally import Tally


class AngularResult(NamedTuple):
    """What an estimator found: result, what stopped it, rays, their paths, polarization.

    `undefined_variables` are variables of which it tells nothing.
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
    """Return what was asked of an estimator, what stopped it, and what it spent."""
    return {
        "relative_stderr": stopping_rule.relative_stderr,
        "max_rays": stopping_rule.max_rays,
        "degree": result.estimate.degree[stopping_rule.side],
        "stop_reason": result.stop_reason,
        "interpolation_error_bound": float(nodes.interpolation_bound.max()),
        "rays": result.n_rays,
        "ensembles": len(nodes.index),
        "kernel": runner.list_kernels(result.tallies) or "scalar",
    }


def count_traced_rays(tallies: Sequence[Tally]) -> int:
    """Return how many rays were traced."""
    return sum(level.n_rays for one in tallies for level in one.strata)


def from_detectors(detector_result: DetectorResult, wavelengths: np.ndarray) -> AngularResult:
    """Return what local estimation found."""
    stokes = detector_result.to_stokes(len(wavelengths)) if detector_result.polarized else {}
    # A bottom hears light at other angles than detectors outside would.
    unseen = () if detector_result.has_lower_side else ("btdf",)
    result = detector_result.to_angular_estimate(len(wavelengths))
    return AngularResult(
        result, detector_result.stop_reason, detector_result.n_rays, (), stokes, unseen
    )


def estimate_by_bins(
    runner: Runner, nodes: IndexNodes, absorption: np.ndarray, n_bins: tuple[int, int], n_rays: int
) -> AngularResult:
    """Trace so many rays and count them in cells."""
    paths = [
        AngularBinTally(number, m, absorption, w, n_bins, runner.tracer.stokes_columns)
        for number, (m, w) in enumerate(zip(nodes.index, nodes.weights, strict=True))
    ]
    each = -(-n_rays // len(paths))
    runner.trace([(e, level, each) for e in paths for level in e.strata], 1.0, 0.0)
    result = estimate_bin_brdf(paths, nodes.interpolation_bound)
    return AngularResult(
        result, "max_rays", count_traced_rays(paths), paths, estimate_bin_stokes(paths)
    )


def relabel_for_diffuse_light(dataset: xr.Dataset) -> xr.Dataset:
    """Return in the terms of diffuse light what was found of a BRDF's place in it."""
    found = dataset
    if "btdf" in dataset:
        for end in ("", "_stderr"):
            found = found.assign({f"transmittance_factor{end}": np.pi * found[f"btdf{end}"]})
    terms = {
        "reflectance_factor": "hemispherical-directional reflectance factor",
        "transmittance_factor": "hemispherical-directional transmittance factor",
        "reflectance": "bihemispherical reflectance",
        "transmittance": "bihemispherical transmittance",
    }
    for name, term in terms.items():
        if name in found:
            about = {"long_name": term, "units": "1", "ancillary_variables": f"{name}_stderr"}
            found[name].attrs = about
            found[f"{name}_stderr"].attrs = {
                "long_name": f"standard error of {term}", "units": "1"
            }  # fmt: skip
    beams = ("brdf", "btdf", "specular_reflectance", "direct_transmittance")
    names = [name + end for name in beams for end in ("", "_stderr")]
    return found.drop_vars([name for name in names if name in found])
