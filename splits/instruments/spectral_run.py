"""Requests and results of spectra, of one medium or of several that share paths."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from splits.core.progress import ProgressCallback
from splits.core.uncertainty import Variable, make_deviation_variable, make_variable
from splits.core.validation import check_choice, check_integer, check_range, invalid
from splits.kernels.grains.scene import NO_GROUND
from splits.simulation.arguments import check_incidence, check_threads, check_wavelengths
from splits.simulation.deep_medium import truncate_deep_medium
from splits.simulation.derivatives import NO_PERTURBATIONS, Perturbations
from splits.simulation.estimators import ESTIMATORS, SpectralEstimate
from splits.simulation.path_tally import PathSharingMedia, SpectralRows
from splits.simulation.runner import Runner
from splits.simulation.tracer import KERNELS
from splits.simulation.truncated_medium import TruncatedMedium

TITLE = "Virtual spectrophotometer"
SIDE_QUANTITIES = ("reflectance", "transmittance")
QUANTITY_LABELS = {
    "reflectance": "hemispherical reflectance",
    "transmittance": "hemispherical transmittance",
    "absorptance": "absorptance",
}


class SpectralResult(NamedTuple):
    """Estimates, and the truncation of the media."""

    estimate: SpectralEstimate
    truncation: TruncatedMedium | None


class SpectralRequest(NamedTuple):
    """Validated arguments of `splits.spectrophotometer`."""

    wavelengths: np.ndarray
    incidence: float | str
    max_stderr: float
    seed: int
    max_rays: int
    threads: int
    kernel: str

    @classmethod
    def from_arguments(
        cls,
        wavelength_nm: Any,
        incidence_deg: Any,
        max_stderr: Any,
        seed: Any,
        max_rays: Any,
        threads: Any,
        kernel: Any,
    ) -> SpectralRequest:
        """Return the request, after checking all values."""
        return cls(
            check_wavelengths(wavelength_nm),
            check_incidence(incidence_deg),
            check_range("max_stderr", max_stderr, 1e-6, 0.5),
            check_integer("seed", seed, 0),
            check_integer("max_rays", max_rays, 1),
            check_threads(threads),
            check_choice("kernel", kernel, KERNELS),
        )

    def truncate(self, path_sharing: PathSharingMedia) -> TruncatedMedium | None:
        """Return the truncated media, which do not depend on the incidence."""
        return truncate_deep_medium(
            path_sharing, self.wavelengths, self.max_stderr, self.seed, self.threads
        )

    def estimate(
        self,
        path_sharing: PathSharingMedia,
        perturbations: Perturbations = NO_PERTURBATIONS,
        estimator: str = "spectral",
        progress: ProgressCallback = None,
    ) -> SpectralResult:
        """Return estimates for media that share paths, or for one with its derivatives."""
        if perturbations.media:
            size_ratios = np.concatenate([path_sharing.size_ratios, perturbations.size_ratios])
            path_sharing = PathSharingMedia(
                (*path_sharing.media, *perturbations.media), size_ratios
            )
        truncation = None if estimator == "analog" else self.truncate(path_sharing)
        return self.estimate_truncated(truncation, path_sharing, perturbations, estimator, progress)

    def estimate_truncated(
        self,
        truncation: TruncatedMedium | None,
        path_sharing: PathSharingMedia,
        perturbations: Perturbations = NO_PERTURBATIONS,
        estimator: str = "spectral",
        progress: ProgressCallback = None,
    ) -> SpectralResult:
        """Return the result of `estimate` for media whose truncation is given."""
        analog = estimator == "analog"
        wavelengths, n_media = self.wavelengths, len(path_sharing.media) - len(perturbations.media)
        traced = (
            path_sharing if truncation is None else path_sharing._replace(media=truncation.media)
        )
        rows = SpectralRows.from_media(traced.select(slice(n_media)), wavelengths)
        if perturbations.media:
            lossless = (
                [] if truncation is None else wavelengths[truncation.ground_absorption[0] == 0.0]
            )
            if len(lossless):
                allowed = "left out for deep media at wavelengths where nothing absorbs"
                hint = f"as at {lossless[0]:g} nm"
                raise invalid("jacobian", list(perturbations.parameters), allowed, hint)
            ground_column = NO_GROUND if truncation is None else rows.absorption.shape[1] - 1
            rows = rows.with_derivatives(
                traced.select(slice(n_media, None)), perturbations.steps, wavelengths, ground_column
            )

        def run_estimator(target_stderr: float) -> SpectralEstimate:
            settings = (self.seed, self.threads, analog, self.kernel, progress)
            runner = Runner(traced.media[0], self.incidence, *settings)
            return ESTIMATORS[estimator](runner, rows, target_stderr, self.max_rays)

        if truncation is None:
            return SpectralResult(run_estimator(self.max_stderr), None)
        return SpectralResult(
            truncation.estimate_to_error(run_estimator, self.max_stderr, perturbations.steps),
            truncation,
        )

    def make_variables(
        self, estimate: SpectralEstimate, dims: tuple[str, ...]
    ) -> dict[str, Variable]:
        """Return the estimates with errors and batch deviations, over media and wavelengths."""
        illumination = "hemispherical" if self.incidence == "diffuse" else "directional"
        shape = (self.wavelengths.size,) if len(dims) == 1 else (-1, self.wavelengths.size)
        variables: dict[str, Variable] = {}
        for row, (name, label) in enumerate(QUANTITY_LABELS.items()):
            long_name = label if name == "absorptance" else f"{illumination}-{label}"
            mean, stderr = estimate.mean[row].reshape(shape), estimate.stderr[row].reshape(shape)
            variables |= make_variable(name, dims, mean, stderr, long_name)
            if name in SIDE_QUANTITIES:
                batch_deviations = estimate.batch_deviations[:, row]
                batch_deviations = batch_deviations.reshape(len(batch_deviations), *shape)
                variables |= make_deviation_variable(name, dims, batch_deviations, long_name)
        return variables

    def make_attributes(self, spectral_result: SpectralResult) -> dict[str, Any]:
        """Return the attributes of a result."""
        result, truncation = spectral_result
        attributes = {
            "incidence_deg": self.incidence,
            "max_stderr": self.max_stderr,
            "stop_reason": "converged" if result.converged else "max_rays",
            "max_stderr_reached": float(result.stderr.max()),
            "interpolation_error_bound": float(result.interpolation_error.max()),
            "max_rays": self.max_rays,
            "rays": result.n_rays,
            "ensembles": result.n_ensembles,
            "kernel": result.kernel,
        }
        if truncation is not None:
            attributes |= {
                "truncation_depth_m": truncation.depth_m,
                "semi_infinite_depth_m": truncation.semi_infinite_depth_m,
            }
        return attributes
