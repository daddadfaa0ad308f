"""Spectra of media that share paths, a dataset for each as if it had been measured alone."""

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
    """Return what `splits.spectrophotometer` would of each medium of a family, from one ensemble.

    Each has the error asked for.  Errors of different media go together, as their `…_batches` tell.

    Parameters
    ----------
    path_sharing : PathSharingMedia
    request : Run
    progress : callable, optional

    Returns
    -------
    list of xarray.Dataset
        ``rays`` are those that all of them share.
    """
    begun = time.perf_counter()
    found = request.estimate(path_sharing, progress=progress)
    whole, count = found.estimate, request.wavelengths.size
    datasets = []
    for number, (medium, scale) in enumerate(zip(*path_sharing, strict=True)):
        rows = slice(number * count, (number + 1) * count)
        own = replace(
            whole,
            mean=whole.mean[:, rows],
            stderr=whole.stderr[:, rows],
            interpolation_error=whole.interpolation_error[:, rows],
            batch_deviations=whole.batch_deviations[..., rows],
            converged=bool(whole.stderr[:, rows].max() <= request.max_stderr),
        )
        cut = found.truncation
        if cut is not None:
            cut = cut._replace(
                depth_m=scale * cut.depth_m, semi_infinite_depth_m=scale * cut.semi_infinite_depth_m
            )
        facts = make_run_attributes(
            TITLE, "spectrophotometer", medium, begun, request.seed, request.threads
        )
        facts |= {"estimator": "spectral"} | request.make_attributes(SpectralResult(own, cut))
        axes = {"wavelength": make_wavelength_coordinate(request.wavelengths)}
        datasets.append(xr.Dataset(request.make_variables(own, ("wavelength",)), axes, facts))
    return datasets
