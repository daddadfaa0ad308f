"""What spectra of one medium, and of several that share paths, have in common."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from splits.checks import in_range, one_of, refuse
from splits.instruments.arguments import (
    check_incidence,
    check_threads,
    check_wavelengths,
    check_whole,
)
from splits.instruments.cut import Cut
from splits.instruments.deep_packs import cut_of
from splits.instruments.estimators import ESTIMATORS, Estimate
from splits.instruments.jacobian import NO_MOVES, Moves
from splits.instruments.progress import Report
from splits.instruments.runner import Runner
from splits.instruments.shared_paths import Family, Rows
from splits.instruments.tracers import KERNELS
from splits.transport.grains.scene import NO_GROUND
from splits.uncertainty import Variable, deviations, quantity

TITLE = "Virtual spectrophotometer"
SIDES = ("reflectance", "transmittance")
QUANTITIES = {
    "reflectance": "hemispherical reflectance",
    "transmittance": "hemispherical transmittance",
    "absorptance": "absorptance",
}


class Found(NamedTuple):
    """Estimates, and where packs were cut for them."""

    estimate: Estimate
    truncation: Cut | None


class Run(NamedTuple):
    """What a user asks of a spectrophotometer, checked; see there."""

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
    ) -> Run:
        """Return what is asked for, or refuse a value outside its range."""
        return cls(
            check_wavelengths(wavelength_nm),
            check_incidence(incidence_deg),
            in_range("max_stderr", max_stderr, 1e-6, 0.5),
            check_whole("seed", seed, 0),
            check_whole("max_rays", max_rays, 1),
            check_threads(threads),
            one_of("kernel", kernel, KERNELS),
        )

    def truncate(self, path_sharing: Family) -> Cut | None:
        """Return where packs are cut, which does not depend on the incidence."""
        return cut_of(path_sharing, self.wavelengths, self.max_stderr, self.seed, self.threads)

    def estimate(
        self,
        path_sharing: Family,
        perturbations: Moves = NO_MOVES,
        estimator: str = "spectral",
        progress: Report = None,
    ) -> Found:
        """Return estimates for media that share paths, or for one, and its derivatives."""
        if perturbations.media:
            scales = np.concatenate([path_sharing.size_ratios, perturbations.size_ratios])
            path_sharing = Family((*path_sharing.media, *perturbations.media), scales)
        cut = None if estimator == "analog" else self.truncate(path_sharing)
        return self.estimate_truncated(cut, path_sharing, perturbations, estimator, progress)

    def estimate_truncated(
        self,
        truncation: Cut | None,
        path_sharing: Family,
        perturbations: Moves = NO_MOVES,
        estimator: str = "spectral",
        progress: Report = None,
    ) -> Found:
        """Return what `estimated` does, where it is known where packs are cut."""
        analog = estimator == "analog"
        w, count = self.wavelengths, len(path_sharing.media) - len(perturbations.media)
        traced = path_sharing if truncation is None else path_sharing._replace(media=truncation.media)
        rows = Rows.from_media(traced.select(slice(count)), w)
        if perturbations.media:
            white = [] if truncation is None else w[truncation.ground_absorption[0] == 0.0]
            if len(white):
                allowed = "left out for deep packs at wavelengths where nothing absorbs"
                hint = f"as at {white[0]:g} nm"
                raise refuse("jacobian", list(perturbations.parameters), allowed, hint)
            ground = NO_GROUND if truncation is None else rows.absorption.shape[1] - 1
            rows = rows.with_derivatives(traced.select(slice(count, None)), perturbations.steps, w, ground)

        def estimate(goal: float) -> Estimate:
            how = (self.seed, self.threads, analog, self.kernel, progress)
            runner = Runner(traced.media[0], self.incidence, *how)
            return ESTIMATORS[estimator](runner, rows, goal, self.max_rays)

        if truncation is None:
            return Found(estimate(self.max_stderr), None)
        return Found(truncation.estimate_to_error(estimate, self.max_stderr, perturbations.steps), truncation)

    def make_variables(self, estimate: Estimate, dims: tuple[str, ...]) -> dict[str, Variable]:
        """Return what was estimated, with errors and groups, over the media and wavelengths."""
        illumination = "hemispherical" if self.incidence == "diffuse" else "directional"
        shape = (self.wavelengths.size,) if len(dims) == 1 else (-1, self.wavelengths.size)
        found: dict[str, Variable] = {}
        for row, (name, label) in enumerate(QUANTITIES.items()):
            long_name = label if name == "absorptance" else f"{illumination}-{label}"
            mean, stderr = estimate.mean[row].reshape(shape), estimate.stderr[row].reshape(shape)
            found |= quantity(name, dims, mean, stderr, long_name)
            if name in SIDES:
                groups = estimate.batch_deviations[:, row]
                groups = groups.reshape(len(groups), *shape)
                found |= deviations(name, dims, groups, long_name)
        return found

    def make_attributes(self, spectral_result: Found) -> dict[str, Any]:
        """Return how it went, for a dataset's attributes."""
        result, cut = spectral_result
        facts = {
            "incidence_deg": self.incidence,
            "max_stderr": self.max_stderr,
            "stopped_by": "error" if result.converged else "rays",
            "max_stderr_reached": float(result.stderr.max()),
            "interpolation_error_bound": float(result.interpolation_error.max()),
            "max_rays": self.max_rays,
            "rays": result.n_rays,
            "ensembles": result.n_ensembles,
            "kernel": result.kernel,
        }
        if cut is not None:
            facts |= {"traced_to_m": cut.depth_m, "optically_deep_m": cut.semi_infinite_depth_m}
        return facts
