"""Spectra of many media at once that differ only in what they absorb."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from splits.core.progress import ProgressCallback, with_progress
from splits.core.validation import invalid, reject_unknown_arguments, to_text_keys
from splits.instruments.spectral_run import TITLE, SpectralRequest
from splits.media.medium import Medium
from splits.simulation.arguments import check_medium
from splits.simulation.attributes import make_run_attributes, make_wavelength_coordinate
from splits.simulation.path_tally import PathSharingMedia, check_path_sharing


@reject_unknown_arguments
@with_progress
def spectra(
    media: Mapping[str, Medium],
    wavelength_nm: Any,
    incidence_deg: float | str = 0.0,
    max_stderr: float = 0.002,
    seed: int = 1,
    *,
    max_rays: int = 20_000_000,
    threads: int | None = None,
    kernel: str = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Measure spectra of media that differ only in what they absorb, from the same paths.

    However many there are, rays are traced once.  Differences between the media are then far
    better known than the spectra, as these share their noise.

    Parameters
    ----------
    media : mapping
        Granular media, or stacks of them, by name: alike but for impurities, or for the albedo of
        a ground that sends light back.
    wavelength_nm, incidence_deg, max_stderr, seed, max_rays, threads, kernel, progress
        As for `splits.spectrophotometer`; the error is reached for every medium.

    Returns
    -------
    xarray.Dataset
        As of `splits.spectrophotometer`, over ``medium`` and ``wavelength``.  Sums over ``batch``
        of products of ``…_batches`` are covariances, between media as between wavelengths.  Inputs
        in which media differ are coordinates over ``medium``.

    Raises
    ------
    ValueError
        For a value outside its range, or a medium that the paths of the first do not serve.

    Examples
    --------
    >>> import splits
    >>> snow = dict(specific_surface_area_m2_kg=20, depth_m=0.3)
    >>> found = splits.spectra(
    ...     {
    ...         "clean": splits.Snow.natural(**snow),
    ...         "dirty": splits.Snow.natural(**snow, impurities_ng_g={"black_carbon": 500}),
    ...     },
    ...     [500, 900],
    ...     max_stderr=0.01,
    ... )
    >>> found.reflectance.dims
    ('medium', 'wavelength')
    """
    if not isinstance(media, Mapping) or not media:
        raise invalid("media", media, "a mapping of names to media, at least one")
    named = to_text_keys("media", media)
    for medium in named.values():
        check_medium(medium, allow_semi_infinite=True)
    check_path_sharing(named)
    run = SpectralRequest.from_arguments(
        wavelength_nm, incidence_deg, max_stderr, seed, max_rays, threads, kernel
    )
    begun = time.perf_counter()
    found = run.estimate(PathSharingMedia.from_media(list(named.values())), progress=progress)
    differing = _find_differing_inputs(list(named.values()))
    one = next(iter(named.values()))
    about = make_run_attributes(TITLE, "spectrophotometer", one, begun, run.seed, run.threads)
    about = {key: value for key, value in about.items() if key not in differing}
    axes = {
        "medium": ("medium", list(named), {"long_name": "name of the medium"}),
        "wavelength": make_wavelength_coordinate(run.wavelengths),
        **differing,
    }
    variables = run.make_variables(found.estimate, ("medium", "wavelength"))
    return xr.Dataset(
        variables, axes, about | {"estimator": "spectral"} | run.make_attributes(found)
    )


def _find_differing_inputs(media: Sequence[Medium]) -> dict[str, Any]:
    """Return as coordinates over the media the inputs in which they differ.

    What some have no amount of, they have 0 of.
    """
    told = [{f"{m.kind}_{k}": v for k, v in m.describe().items()} for m in media]
    differing: dict[str, Any] = {}
    for key in dict.fromkeys(key for one in told for key in one):
        values: list[Any] = [one.get(key) for one in told]
        if all(np.array_equal(value, values[0]) for value in values):
            continue
        amounts = all(value is None or isinstance(value, int | float) for value in values)
        shown: list[Any] = (
            [0.0 if value is None else float(value) for value in values]
            if amounts
            else ["" if value is None else str(value) for value in values]
        )
        differing[key] = ("medium", shown, {"long_name": key.replace("_", " ")})
    return differing
