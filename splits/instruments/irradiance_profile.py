"""Light inside a sample: irradiances at depths, and what is absorbed between them."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.arrays import as_1d_array, check_array_range, check_increasing
from splits.core.progress import ProgressCallback, with_progress
from splits.core.validation import (
    ROUNDING_TOLERANCE,
    check_choice,
    check_range,
    invalid,
    reject_unknown_arguments,
)
from splits.instruments.flux_dataset import make_flux_dataset
from splits.instruments.flux_estimate import estimate_flux
from splits.instruments.flux_media import TracedMedium, get_thickness, prepare_medium
from splits.instruments.flux_stopping_rule import FluxStoppingRule
from splits.instruments.flux_tally import FLUX_RAYS_PER_CHUNK, FluxPathTally
from splits.media.medium import (
    GranularMedium,
    LayeredMedium,
    Medium,
    ParticleMedium,
    compute_path_fractions,
)
from splits.simulation.arguments import (
    check_incidence,
    check_integer,
    check_medium,
    check_threads,
    check_wavelengths,
)
from splits.simulation.attributes import make_run_attributes
from splits.simulation.runner import Runner
from splits.simulation.spectral_nodes import MAX_NODES, IndexNodes, choose_nodes
from splits.simulation.tally import N_BATCHES
from splits.simulation.tracer import KERNELS

MAX_DEPTHS = 200
MAX_TALLY_VALUES = 100_000_000
"""Sums by group, layer, material and wavelength that are held: some three times their memory."""
INTERPOLATION_FRACTION = 0.4
"""Part of the error asked for that interpolation between indices may take."""
BAND_INTERPOLATION_FRACTION = 0.04
"""The same where errors are those of bands: more indices then take hardly any more rays."""
ERROR_QUANTITIES = ("irradiance", "absorptance")
"""Quantities that a largest error is asked of: the first stands for all of them."""


@reject_unknown_arguments
@with_progress
def irradiance_profile(
    medium: Medium,
    wavelength_nm: Any,
    depth_m: Any,
    incidence_deg: float | str = 0.0,
    max_stderr: float = 0.005,
    seed: int = 1,
    *,
    target: str = "irradiance",
    max_rays: int = 20_000_000,
    threads: int | None = None,
    kernel: str = "auto",
    progress: ProgressCallback = None,
) -> xr.Dataset:
    """Return irradiances inside a medium, and where its light is absorbed.

    Parameters
    ----------
    medium : GranularMedium, LayeredMedium or ParticleMedium
        For example `splits.Snow`, `splits.Stack` or `splits.ParticleLayer`; may have no end.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    depth_m : array_like
        Strictly increasing depths (m) inside the medium, at most 200.  Its top and its bottom are
        added to them; of a medium without end, only the top.
    incidence_deg : float or "diffuse"
        Polar angle of a beam, 0 to 89.9999 degrees, or equal radiance from everywhere.
    max_stderr : float
        Largest standard error wanted, 1e-6 to 0.5; see `target`.
    seed : int
        Non-negative; the same seed gives the same numbers on any number of threads.
    target : {"irradiance", "absorptance"}
        Quantities whose errors `max_stderr` limits: all irradiances and absorptances, or only
        absorptances and reflectance.  In bright and thick media the latter take far fewer rays.
    max_rays, threads, kernel, progress
        As for `splits.spectrophotometer`.

    Returns
    -------
    xarray.Dataset
        Over ``wavelength`` and ``depth``, in units of the irradiance from above:
        ``downward_irradiance`` and ``upward_irradiance``, the latter at the top the reflectance.
        Over ``wavelength`` and ``interval``, between successive depths: ``absorptance``, the share
        of the light that is absorbed there, and ``actinic_flux``, the mean path of the light in
        the interval over its thickness, grains and pores together.  ``absorptance_of_material``
        over ``material`` besides.  All with standard errors ``…_stderr``; irradiances and
        absorptances also with ``…_batches``, see `splits.core.uncertainty`.  Reflectance,
        absorptances, and the net irradiance at the bottom add up to 1.  The last interval of a
        medium without end goes on below all depths; its mean actinic flux is 0 if it absorbs.

    Raises
    ------
    ValueError
        For a value outside its range.

    Notes
    -----
    Small particles absorb along the path here, which is the same to light; what they absorb counts
    for the matrix of their layer.

    Light inside a grain that lies across a plane counts as passing it where the ray leaves the
    grain on the other side, and what that grain absorbs belongs to the interval of its entry.  A
    plane at a face between layers of different saturation counts the light that passes; what the
    face reflects does not, on either side of it.

    Actinic flux and shares of materials take weights to fall evenly along the path between planes.
    Where single grains or pores absorb much of the light that crosses them, both are rough; their
    errors hold what that may be (`splits.instruments.flux_errors`).

    References
    ----------
    Paths and weights are those of SPLITSnow Eqs 5-6; actinic flux as path per volume, for example
    Mayer (2009), EPJ Web of Conferences 1, 75, section 4.
    """
    asked = FluxRequest(
        medium, wavelength_nm, depth_m, incidence_deg, seed, max_rays, threads, kernel, progress
    ).validate()
    max_stderr = check_range("max_stderr", max_stderr, 1e-6, 0.5)
    whole = check_choice("target", target, ERROR_QUANTITIES) == ERROR_QUANTITIES[0]
    return simulate_flux(asked, FluxStoppingRule(max_stderr, whole))


class FluxRequest(NamedTuple):
    """What is to be known of the light inside, see `irradiance_profile`."""

    medium: Any
    wavelengths: Any
    depths: Any
    incidence: Any
    seed: Any
    max_rays: Any
    threads: Any
    kernel: str
    progress: ProgressCallback

    def validate(self) -> FluxRequest:
        """Return it, or refuse a value outside its range."""
        check_medium(
            self.medium, GranularMedium, LayeredMedium, ParticleMedium, allow_semi_infinite=True
        )
        return self._replace(
            wavelengths=check_wavelengths(self.wavelengths),
            depths=_check_depths(self.depths, get_thickness(self.medium)),
            incidence=check_incidence(self.incidence),
            seed=check_integer("seed", self.seed, 0),
            max_rays=check_integer("max_rays", self.max_rays, 1),
            threads=check_threads(self.threads),
            kernel=check_choice("kernel", self.kernel, KERNELS),
        )


def simulate_flux(request: FluxRequest, stopping_rule: FluxStoppingRule) -> xr.Dataset:
    """Return the dataset of `irradiance_profile`, for quantities known as well as a goal asks for."""
    begun = time.perf_counter()
    medium, seed, threads = request.medium, request.seed, request.threads
    traced = prepare_medium(
        medium, request.wavelengths, request.depths, stopping_rule.max_stderr, seed, threads
    )
    runner = Runner(
        traced.medium, request.incidence, seed, threads, False, request.kernel, request.progress,
        planes_m=request.depths.tolist(),
    )  # fmt: skip
    runner.rays_per_chunk = FLUX_RAYS_PER_CHUNK
    index, absorption = traced.constants
    nodes = _choose_nodes(index, traced.medium, stopping_rule)
    layers = len(runner.tracer.boundary_depths_m) - 1
    _check_memory(traced, layers, len(nodes.index))
    fractions = np.ones(absorption.shape[1])
    own = compute_path_fractions(traced.medium)
    fractions[: own.size] = own
    ensembles = [
        FluxPathTally(number, m, absorption, w > 0.0, runner.tracer.traits, layers, fractions)
        for number, (m, w) in enumerate(zip(nodes.index, nodes.weights, strict=True))
    ]
    runner.share_kernel(ensembles)
    outcome = estimate_flux(runner, ensembles, nodes, traced, stopping_rule, request.max_rays)
    facts = {
        **make_run_attributes("Light inside", "irradiance_profile", medium, begun, seed, threads),
        "incidence_deg": request.incidence,
        "max_stderr": stopping_rule.max_stderr,
        "target": ERROR_QUANTITIES[0] if stopping_rule.limit_irradiance else ERROR_QUANTITIES[1],
        "stop_reason": outcome.stop_reason,
        "max_stderr_reached": outcome.max_stderr_reached,
        "interpolation_error_bound": float(nodes.interpolation_bound.max()),
        "max_rays": request.max_rays,
        "rays": sum(level.n_rays for e in ensembles for level in e.strata),
        "ensembles": len(ensembles),
        "kernel": runner.list_kernels(ensembles),
    }
    if traced.semi_infinite:
        facts["truncation_depth_m"] = float(traced.planes_m[-1])
    return make_flux_dataset(outcome, traced, request.wavelengths, facts)


def _choose_nodes(index: np.ndarray, medium: Medium, stopping_rule: FluxStoppingRule) -> IndexNodes:
    """Return refractive indices to trace with: more of them where many share the rays of a band."""
    found = choose_nodes(
        index, medium.list_interfaces(), INTERPOLATION_FRACTION * stopping_rule.max_stderr
    )
    if stopping_rule.band_weights is None:
        return found
    finer = choose_nodes(
        index, medium.list_interfaces(), BAND_INTERPOLATION_FRACTION * stopping_rule.max_stderr
    )
    return finer if len(finer.index) <= MAX_NODES else found


def _check_depths(depth_m: Any, thickness: float) -> np.ndarray:
    """Return depths inside a sample of a thickness (m), or refuse them."""
    depths = check_increasing("depth_m", as_1d_array("depth_m", depth_m, "numbers in metres"))
    if depths.size > MAX_DEPTHS:
        raise invalid("depth_m", f"{depths.size} depths", f"at most {MAX_DEPTHS}")
    hint = "top and bottom are there in any case"
    # Rounding leaves what is meant as the bottom on either side of it.
    bottom = np.isclose(depths, thickness, rtol=ROUNDING_TOLERANCE, atol=0.0)
    depths = np.where(bottom, thickness, depths)
    return check_array_range(
        "depth_m", depths, 0.0, thickness, "m", open_low=True, open_high=True, hint=hint
    )


def _check_memory(traced_medium: TracedMedium, n_layers: int, n_nodes: int) -> None:
    """Refuse what would not fit into memory."""
    rows, columns = traced_medium.constants.absorption.shape
    wavelengths, sums = (
        traced_medium.n_wavelengths,
        N_BATCHES * n_layers * (columns + 3) * rows * n_nodes,
    )
    if sums > MAX_TALLY_VALUES:
        raise invalid(
            "wavelength_nm", f"{wavelengths} wavelengths",
            f"at most {max(1, wavelengths * MAX_TALLY_VALUES // sums)} with so many depths and layers",
            "several calls hold more",
        )  # fmt: skip
