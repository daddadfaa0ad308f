"""Spectral and band albedo under a sky, with correlated errors propagated."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from splits.core.inputs import (
    DIFFUSE,
    Kernel,
    MaxRays,
    Seed,
    Solver,
    StandardError,
    Threads,
    Wavelengths,
)
from splits.core.keywords import declare_function
from splits.core.progress import ProgressCallback
from splits.core.uncertainty import make_variable
from splits.illumination.bands import Bands
from splits.illumination.sky import SkyInput
from splits.instruments.sky_mixing import (
    DIRECT_FRACTION,
    as_sky,
    average_over_bands,
    choose_wavelengths,
    make_sky_attributes,
    mix_direct_and_diffuse,
)
from splits.instruments.snow_packs import (
    PACK_DIM,
    SUN,
    SUN_OF_EACH,
    ZENITH_STEP_DEG,
    average_over_pack_bands,
    choose_pack_solver,
    describe_solution,
    label_snow_packs,
    make_skies,
    solve_snow_packs,
)
from splits.instruments.solver import (
    MONTE_CARLO,
    choose_solver,
    make_estimate,
    solve_reflectances,
)
from splits.instruments.spectrophotometer import (
    SpectralRequest,
    check_media,
    label_media,
    make_pack_spectrum,
    make_spectrum,
    spectrophotometer,
)
from splits.media.medium import Medium
from splits.media.snow_packs import SnowPacks
from splits.simulation.run_options import RunOptions, make_wavelength_coordinate


@declare_function
def albedo(
    medium: Medium | Mapping[str, Medium] | SnowPacks,
    sky: SkyInput,
    wavelength_nm: Wavelengths | None = None,
    *,
    max_stderr: StandardError = 0.005,
    solver: Solver = "auto",
    bands: Bands = None,
    seed: Seed = 1,
    max_rays: MaxRays = 20_000_000,
    threads: Threads = None,
    kernel: Kernel = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Simulate the albedo of a medium under a sky (blue-sky albedo).

    Parameters
    ----------
    medium : Medium, mapping or SnowPacks
        For example `splits.Snow`, or a mapping from names to media that share paths, as for
        `splits.spectrophotometer`.  The errors of differences between these media are much smaller
        than those of their albedos (``dataset.errors.difference``).  Or
        `splits.SnowPacks`, the snowpacks of a season, by discrete ordinates.
    sky : Sky, str, mapping or function
        See `splits.sky`.  Over `splits.SnowPacks` with ``sun_zenith_deg``, a name or a table
        applies to the zenith angle of each snowpack, and so does a function that returns a sky for
        a zenith angle (degrees); a `Sky` is the same for all (`splits.instruments.snow_packs`).
    wavelength_nm : array_like, optional
        Strictly increasing vacuum wavelengths (nm), at least two; by default every 10 nm from
        the first of the sky to 2495.
    max_stderr : float
        Largest standard error of the reflectance at any wavelength, separately for direct sunlight
        and for diffuse light, 1e-6 to 0.5.  The albedo combines both, so its error is at most this.
    solver : {"auto", "discrete_ordinates", "monte_carlo"}
        As for `splits.spectrophotometer`.
    bands : mapping or str, optional
        Names of bands to their limits (nm): ``{"visible": (305, 700)}``; or to a spectral response,
        a mapping of ``wavelength_nm`` and ``response`` or the path of a CSV file with these
        columns; or the name of a sensor, see `splits.sensor_bands`.
    seed : int
        Non-negative; diffuse light uses the next one.
    max_rays, threads, kernel
        As for `splits.spectrophotometer`.
    progress : callable or bool, optional
        True shows a progress bar; a function is called periodically with a `Progress`.

    Returns
    -------
    xarray.Dataset
        ``albedo`` and its error ``albedo_stderr`` over ``wavelength``, with ``albedo_batches`` for
        errors of combinations of wavelengths if paths are traced; ``direct_fraction``, the fraction
        of direct light; and over ``band``, the first of which is "broadband", ``band_albedo`` with
        ``band_albedo_stderr``, weighted by irradiance times response, ``band_albedo_batches``, and
        ``irradiance_covered``, the fraction of the band's light within the wavelengths.  With
        several media all but the last are over ``medium``, too.  For `splits.SnowPacks` all are
        over the label, and snowpacks without result have a ``quality_flag``, as for
        `splits.spectrophotometer`.

    Raises
    ------
    ValueError
        For a value outside its range, or wavelengths outside the spectrum of the sky.
    """
    run = RunOptions.start(seed, threads, kernel, progress)
    packs: SnowPacks | None = None
    leading: tuple[str, ...] = ()
    if isinstance(medium, SnowPacks):
        packs, leading = medium, (PACK_DIM,)
        skies, members, sun = make_skies(sky, packs)
    else:
        media, skies = check_media(medium), [as_sky(sky)]
        leading = ("medium",) if isinstance(medium, Mapping) else ()
    first = packs if packs is not None else next(iter(media.values()))
    first_sky = skies[0]
    wavelengths = choose_wavelengths(wavelength_nm, first_sky, 2)
    fractions = [one.compute_direct_fraction(wavelengths) for one in skies]
    named = first_sky.make_bands(bands)
    first_sky.check_bands(named, wavelengths)
    dims = (*leading, "wavelength")
    coordinates = {"wavelength": wavelengths}
    direct_fraction = xr.DataArray(fractions[0], coordinates, ("wavelength",))
    if packs is not None:
        choice = choose_pack_solver(solver, packs, wavelengths)
        # One solution holds the spectra under the sun of each snowpack, and under diffuse light.
        solution, flags = solve_snow_packs(
            packs, wavelengths, sun, max_stderr, run, only_reflectance=True
        )
        by_pack = np.full((len(packs), wavelengths.size), np.nan)
        for rows, fraction in zip(members, fractions, strict=True):
            by_pack[rows] = fraction
        direct_fraction = xr.DataArray(by_pack, coordinates, dims)
    else:
        choice = choose_solver(
            solver, media.values(), wavelengths, max_stderr, run.threads, max_stderr=max_stderr
        )
        sun = first_sky.zenith_deg if direct_fraction.any() else DIFFUSE
        solutions = solve_reflectances(choice.stacks, [sun], max_stderr)

    def simulate_component(incidence: float | str, number: int) -> xr.Dataset:
        request = SpectralRequest(wavelengths, incidence, max_stderr, max_rays, run)
        if packs is not None:
            spectrum = make_pack_spectrum(request, packs, choice, solution)
            # Without the memory of the other quantities.
            return spectrum[["reflectance", "reflectance_stderr"]].copy(deep=True)
        if choice.stacks:
            estimate = make_estimate(solutions, -1 if incidence == DIFFUSE else 0)
            spectrum = make_spectrum(request, first, estimate, dims=dims)
            spectrum.attrs |= choice.attributes
            return label_media(spectrum, media) if isinstance(medium, Mapping) else spectrum
        return spectrophotometer(
            medium, wavelengths, incidence, max_stderr=max_stderr, solver=MONTE_CARLO,
            seed=run.seed + number, max_rays=max_rays, threads=run.threads, kernel=kernel,
            progress=progress,
        )  # fmt: skip

    mixed = mix_direct_and_diffuse(
        first_sky, wavelengths, simulate_component, ["reflectance"], direct_fraction
    )
    attributes = {
        **run.make_attributes("Albedo under a sky", "albedo", first),
        **make_sky_attributes(first_sky, named),
        "max_stderr": max_stderr,
        **mixed.attrs,
    }
    axes = {**mixed.coords, "wavelength": make_wavelength_coordinate(wavelengths)}
    axes["band"] = list(named)
    values, stderr = (
        mixed[name].transpose(*dims).values for name in ("reflectance", "reflectance_stderr")
    )
    deviations = None
    if "reflectance_batches" in mixed:
        deviations = mixed.reflectance_batches.transpose("batch", *dims).values
    variables = {
        **make_variable(
            "albedo", dims, values, stderr, "albedo under this sky", deviations=deviations
        ),
        "direct_fraction": (
            direct_fraction.dims, direct_fraction.values, DIRECT_FRACTION.attributes,
        ),
    }  # fmt: skip
    spectrum = xr.Dataset(variables, axes, attributes)
    if packs is None:
        return spectrum.assign(average_over_bands(spectrum, "albedo", first_sky, named, "albedo"))
    if sun == SUN:
        spectrum.attrs |= {"zenith_deg": SUN_OF_EACH, "sky_zenith_step_deg": ZENITH_STEP_DEG}
    spectrum.attrs |= describe_solution(solution)
    means = average_over_pack_bands(spectrum, skies, members, named)
    return label_snow_packs(spectrum.assign(means), packs, flags)
