"""Simulation of spectra, of one medium or of several that share paths."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.uncertainty import Variable, make_deviation_variable, make_variable
from splits.core.validation import check_integer, check_range, invalid
from splits.kernels.scene import NO_GROUND
from splits.kernels.tallies.exits import N_BATCHES
from splits.media.medium import Medium
from splits.simulation.deep_medium import (
    ERROR_BUDGET_FRACTION,
    TruncatedMedium,
    truncate_deep_medium,
)
from splits.simulation.derivatives import NO_PERTURBATIONS, Perturbations
from splits.simulation.engine import simulate
from splits.simulation.run_options import (
    RunOptions,
    check_incidence,
    check_wavelengths,
    make_wavelength_coordinate,
)
from splits.simulation.scene import IncidentPolarization, build_scene, describe_polarization
from splits.simulation.shared_paths import PathSharingMedia, SpectralRows
from splits.simulation.spectral_nodes import (
    INTERPOLATION_FRACTION,
    choose_nodes,
    make_separate_nodes,
)
from splits.simulation.spectral_tally import SpectralEstimate, SpectralTally
from splits.simulation.strata import StoppingRule

MAX_ATTEMPTS = 3
"""Runs of a truncated medium, each to half the error of the one before."""
SIDE_QUANTITIES = ("reflectance", "transmittance")
QUANTITY_LABELS = {
    "reflectance": "hemispherical reflectance",
    "transmittance": "hemispherical transmittance",
    "absorptance": "absorptance",
}


class SpectralRequest(NamedTuple):
    """Validated arguments of `splits.spectrophotometer`."""

    wavelengths: np.ndarray
    incidence: float | str
    max_stderr: float
    max_rays: int
    run: RunOptions
    polarization: IncidentPolarization | None = None

    @classmethod
    def from_arguments(
        cls, wavelength_nm: Any, incidence_deg: Any, max_stderr: Any, max_rays: Any, run: RunOptions
    ) -> SpectralRequest:
        """Return the request, after checking all values."""
        return cls(
            check_wavelengths(wavelength_nm),
            check_incidence(incidence_deg),
            check_range("max_stderr", max_stderr, 1e-6, 0.5),
            check_integer("max_rays", max_rays, 1),
            run,
        )

    def truncate(self, path_sharing: PathSharingMedia) -> TruncatedMedium | None:
        """Return the truncated media, which do not depend on the incidence."""
        return truncate_deep_medium(path_sharing, self.wavelengths, self.max_stderr, self.run)

    def simulate(
        self,
        path_sharing: PathSharingMedia,
        truncation: TruncatedMedium | None,
        perturbations: Perturbations = NO_PERTURBATIONS,
        *,
        analog: bool = False,
    ) -> SpectralEstimate:
        """Return estimates for media that share paths, or for one with its derivatives.

        A truncated medium is traced to a smaller error than requested, since the error of the
        theory adds to it.  If more light than predicted reaches the truncation depth, it is traced
        again, to an even smaller error.

        Parameters
        ----------
        path_sharing : PathSharingMedia
            With the perturbed media of the perturbations.
        truncation : TruncatedMedium or None
            Their truncation.
        perturbations : Perturbations
        analog : bool
            Trace each row separately, with analog absorption.  This is the algorithm of SPLITS
            section 4.3 and SPLITSnow section 3, kept as the reference.
        """
        traced = path_sharing if truncation is None else truncation.path_sharing
        rows = self._make_rows(traced, truncation, perturbations)
        scene = build_scene(traced.media[0], self.incidence, analog, self.polarization)
        above_truncation = (1.0 - ERROR_BUDGET_FRACTION**2) ** 0.5
        target = self.max_stderr * (1.0 if truncation is None else above_truncation)
        for _ in range(MAX_ATTEMPTS):
            if analog:
                nodes = make_separate_nodes(rows.index)
            else:
                tolerance = INTERPOLATION_FRACTION * target
                nodes = choose_nodes(rows.index, rows.interfaces, tolerance)
            tally = SpectralTally(rows, nodes, scene)
            evaluation = simulate(scene, tally, StoppingRule(target, self.max_rays), self.run)
            above: SpectralEstimate = evaluation.estimate
            if truncation is None:
                return above
            estimate = truncation.complete_estimate(above)
            if estimate.stderr.max() <= self.max_stderr or evaluation.stop_reason == "max_rays":
                break
            target *= 0.5
        if truncation is not None and traced.n_perturbed:
            derivatives = truncation.complete_derivatives(above, perturbations.steps)
            estimate = replace(estimate, derivatives=derivatives)
        return estimate

    def _make_rows(
        self,
        traced: PathSharingMedia,
        truncation: TruncatedMedium | None,
        perturbations: Perturbations,
    ) -> SpectralRows:
        """Return the rows of media, or of one with its derivatives."""
        reported, perturbed = traced.split()
        rows = SpectralRows.from_media(reported, self.wavelengths)
        if not perturbed.media:
            return rows
        if truncation is not None and (truncation.ground_absorption[0] == 0.0).any():
            lossless = self.wavelengths[truncation.ground_absorption[0] == 0.0]
            allowed = "left out for deep media at wavelengths where nothing absorbs"
            hint = f"as at {lossless[0]:g} nm"
            raise invalid("jacobian", list(perturbations.parameters), allowed, hint)
        ground_column = NO_GROUND if truncation is None else rows.absorption.shape[1] - 1
        return rows.with_derivatives(
            perturbed, perturbations.steps, self.wavelengths, ground_column
        )


def make_spectrum(
    request: SpectralRequest,
    medium: Medium,
    estimate: SpectralEstimate,
    *,
    truncation: TruncatedMedium | None,
    size_ratio: float = 1.0,
    dims: tuple[str, ...] = ("wavelength",),
) -> xr.Dataset:
    """Return the dataset of `splits.spectrophotometer`.

    Parameters
    ----------
    request : SpectralRequest
    medium : Medium
        Its inputs are attributes.
    estimate : SpectralEstimate
    truncation : TruncatedMedium or None
    size_ratio : float
        Size of the medium relative to the traced one.
    dims : tuple of str
        Dimensions of the variables: over media, too, where there are several.
    """
    illumination = "hemispherical" if request.incidence == "diffuse" else "directional"
    shape = (*[-1] * (len(dims) - 1), request.wavelengths.size)
    variables: dict[str, Variable] = {}
    for row, (name, label) in enumerate(QUANTITY_LABELS.items()):
        long_name = label if name == "absorptance" else f"{illumination}-{label}"
        mean, stderr = estimate.mean[row].reshape(shape), estimate.stderr[row].reshape(shape)
        variables |= make_variable(name, dims, mean, stderr, long_name)
        if name in SIDE_QUANTITIES:
            deviations = estimate.batch_deviations[:, row].reshape(N_BATCHES, *shape)
            variables |= make_deviation_variable(name, dims, deviations, long_name)
    attributes = {
        **request.run.make_attributes("Virtual spectrophotometer", "spectrophotometer", medium),
        "solver": "monte_carlo",
        "estimator": "spectral",
        "incidence_deg": request.incidence,
        **describe_polarization(request.polarization),
        "max_stderr": request.max_stderr,
        "stop_reason": estimate.get_stop_reason(request.max_stderr, request.max_rays),
        "max_stderr_reached": float(estimate.stderr.max()),
        "interpolation_error_bound": float(estimate.interpolation_error.max()),
        "max_rays": request.max_rays,
        **estimate.rays,
    }
    if truncation is not None:
        attributes["truncation_depth_m"] = size_ratio * truncation.depth_m
        attributes["semi_infinite_depth_m"] = size_ratio * truncation.semi_infinite_depth_m
    coordinates = {"wavelength": make_wavelength_coordinate(request.wavelengths)}
    return xr.Dataset(variables, coordinates, attributes)


def simulate_spectra(path_sharing: PathSharingMedia, request: SpectralRequest) -> list[xr.Dataset]:
    """Return the dataset of `splits.spectrophotometer` for each medium of a set that shares paths.

    Each has the requested error.  The `…_batches` of different media give the correlations of their
    errors.

    Parameters
    ----------
    path_sharing : PathSharingMedia
    request : SpectralRequest

    Returns
    -------
    list of xarray.Dataset
        The attribute ``rays`` counts those used by all media.
    """
    n_wavelengths, truncation = request.wavelengths.size, request.truncate(path_sharing)
    estimate = request.simulate(path_sharing, truncation)
    datasets = []
    for number, medium in enumerate(path_sharing.media):
        rows = slice(number * n_wavelengths, (number + 1) * n_wavelengths)
        medium_estimate = estimate.select(rows)
        size_ratio = path_sharing.size_ratios[number]
        spectrum = make_spectrum(
            request, medium, medium_estimate, truncation=truncation, size_ratio=size_ratio
        )
        datasets.append(spectrum)
    return datasets
