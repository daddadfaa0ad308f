"""Spectra of media that share paths, with a dataset for each as if it had been simulated alone."""

from __future__ import annotations

import time
from dataclasses import replace

import xarray as xr

from splits.core.progress import ProgressCallback
from splits.instruments.spectral_run import TITLE, SpectralRequest, SpectralResult
from splits.simulation.attributes import make_run_attributes, make_wavelength_coordinate
from splits.simulation.path_tally import PathSharingMedia


def simulate_spectra(
    path_sharing: PathSharingMedia, request: SpectralRequest, progress: ProgressCallback = None
) -> list[xr.Dataset]:
    """Return the dataset of `splits.spectrophotometer` for each medium of a set that shares paths.

    Each has the requested error.  The `…_batches` of different media give the correlations of their
    errors.

    Parameters
    ----------
    path_sharing : PathSharingMedia
    request : SpectralRequest
    progress : callable, optional

    Returns
    -------
    list of xarray.Dataset
        The attribute ``rays`` counts those used by all media.
    """
    start_time = time.perf_counter()
    result = request.estimate(path_sharing, progress=progress)
    estimate, n_wavelengths = result.estimate, request.wavelengths.size
    datasets = []
    for position, (medium, size_ratio) in enumerate(zip(*path_sharing, strict=True)):
        rows = slice(position * n_wavelengths, (position + 1) * n_wavelengths)
        medium_estimate = replace(
            estimate,
            mean=estimate.mean[:, rows],
            stderr=estimate.stderr[:, rows],
            interpolation_error=estimate.interpolation_error[:, rows],
            batch_deviations=estimate.batch_deviations[..., rows],
            converged=bool(estimate.stderr[:, rows].max() <= request.max_stderr),
        )
        truncation = result.truncation
        if truncation is not None:
            truncation = truncation._replace(
                depth_m=size_ratio * truncation.depth_m,
                semi_infinite_depth_m=size_ratio * truncation.semi_infinite_depth_m,
            )
        attributes = make_run_attributes(
            TITLE, "spectrophotometer", medium, start_time, request.seed, request.threads
        )
        attributes |= {"estimator": "spectral"} | request.make_attributes(
            SpectralResult(medium_estimate, truncation)
        )
        coordinates = {"wavelength": make_wavelength_coordinate(request.wavelengths)}
        datasets.append(
            xr.Dataset(
                request.make_variables(medium_estimate, ("wavelength",)), coordinates, attributes
            )
        )
    return datasets
