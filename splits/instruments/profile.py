"""Light inside a sample: irradiances at depths, and what is absorbed between them."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.arrays import check_each, increasing, row_of
from splits.checks import ROUNDING, in_range, known_arguments, one_of, refuse
from splits.instruments.arguments import (
    check_incidence,
    check_medium,
    check_threads,
    check_wavelengths,
    check_whole,
)
from splits.instruments.ensemble import GROUPS
from splits.instruments.inside import found_by
from splits.instruments.inside_dataset import labelled
from splits.instruments.inside_goal import Goal
from splits.instruments.inside_media import Traced, thickness_of, traced_as
from splits.instruments.labels import run_facts
from splits.instruments.nodes import MAX_NODES, Nodes, choose_nodes
from splits.instruments.planes import BATCH, Planes
from splits.instruments.progress import Report, shows_progress
from splits.instruments.runner import Runner
from splits.instruments.tracers import KERNELS
from splits.media.granular import GranularMedium, LayeredMedium, path_fractions
from splits.media.turbid import Medium, TurbidMedium

MOST_DEPTHS = 200
MOST_SUMS = 100_000_000
"""Sums by group, layer, material and wavelength that are held: some three times their memory."""
BIAS_SHARE = 0.4
"""Part of the error asked for that interpolation between indices may take."""
BAND_BIAS_SHARE = 0.04
"""The same where errors are those of bands: more indices then take hardly any more rays."""
ERROR_OF = ("irradiance", "absorptance")
"""Quantities that a largest error is asked of: the first stands for all of them."""


@known_arguments
@shows_progress
def profile(
    medium: Medium,
    wavelength_nm: Any,
    depth_m: Any,
    incidence_deg: float | str = 0.0,
    max_stderr: float = 0.005,
    seed: int = 1,
    *,
    error_of: str = "irradiance",
    max_rays: int = 20_000_000,
    threads: int | None = None,
    kernel: str = "auto",
    progress: Report = None,
) -> xr.Dataset:
    """Return irradiances inside a medium, and where its light is absorbed.

    Parameters
    ----------
    medium : GranularMedium, LayeredMedium or TurbidMedium
        For example `splits.Snow`, `splits.Stack` or `splits.Layer`; may have no end.
    wavelength_nm : array_like
        Strictly increasing vacuum wavelengths (nm), see `splits.spectrophotometer`.
    depth_m : array_like
        Strictly increasing depths (m) inside the medium, at most 200.  Its top and its bottom are
        added to them; of a medium without end, only the top.
    incidence_deg : float or "diffuse"
        Polar angle of a beam, 0 to 89.9999 degrees, or equal radiance from everywhere.
    max_stderr : float
        Largest standard error wanted, 1e-6 to 0.5; see `error_of`.
    seed : int
        Non-negative; the same seed gives the same numbers on any number of threads.
    error_of : {"irradiance", "absorptance"}
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
        absorptances also with ``…_groups``, see `splits.analysis.errors`.  Reflectance,
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
    errors hold what that may be (`splits.instruments.inside_errors`).

    References
    ----------
    Paths and weights are those of SPLITSnow Eqs 5-6; actinic flux as path per volume, for example
    Mayer (2009), EPJ Web of Conferences 1, 75, section 4.
    """
    asked = Inquiry(
        medium, wavelength_nm, depth_m, incidence_deg, seed, max_rays, threads, kernel, progress
    ).validate()
    max_stderr = in_range("max_stderr", max_stderr, 1e-6, 0.5)
    whole = one_of("error_of", error_of, ERROR_OF) == ERROR_OF[0]
    return measure(asked, Goal(max_stderr, whole))


class Inquiry(NamedTuple):
    """What is to be known of the light inside, see `profile`."""

    medium: Any
    wavelengths: Any
    depths: Any
    incidence: Any
    seed: Any
    max_rays: Any
    threads: Any
    kernel: str
    progress: Report

    def validate(self) -> Inquiry:
        """Return it, or refuse a value outside its range."""
        check_medium(self.medium, GranularMedium, LayeredMedium, TurbidMedium, allow_semi_infinite=True)
        return self._replace(
            wavelengths=check_wavelengths(self.wavelengths),
            depths=_check_depths(self.depths, thickness_of(self.medium)),
            incidence=check_incidence(self.incidence),
            seed=check_whole("seed", self.seed, 0),
            max_rays=check_whole("max_rays", self.max_rays, 1),
            threads=check_threads(self.threads),
            kernel=one_of("kernel", self.kernel, KERNELS),
        )


def measure(request: Inquiry, stopping_rule: Goal) -> xr.Dataset:
    """Return the dataset of `profile`, for quantities known as well as a goal asks for."""
    begun = time.perf_counter()
    medium, seed, threads = request.medium, request.seed, request.threads
    traced = traced_as(medium, request.wavelengths, request.depths, stopping_rule.max_stderr, seed, threads)
    runner = Runner(
        traced.medium, request.incidence, seed, threads, False, request.kernel, request.progress,
        planes_m=request.depths.tolist(),
    )  # fmt: skip
    runner.rays_per_chunk = BATCH
    index, absorption = traced.constants
    nodes = _nodes(index, traced.medium, stopping_rule)
    layers = len(runner.tracer.boundary_depths_m) - 1
    _check_memory(traced, layers, len(nodes.index))
    fractions = np.ones(absorption.shape[1])
    own = path_fractions(traced.medium)
    fractions[: own.size] = own
    ensembles = [
        Planes(number, m, absorption, w > 0.0, runner.tracer.traits, layers, fractions)
        for number, (m, w) in enumerate(zip(nodes.index, nodes.weights, strict=True))
    ]
    runner.share_kernel(ensembles)
    outcome = found_by(runner, ensembles, nodes, traced, stopping_rule, request.max_rays)
    facts = {
        **run_facts("Light inside", "profile", medium, begun, seed, threads),
        "incidence_deg": request.incidence,
        "max_stderr": stopping_rule.max_stderr,
        "error_of": ERROR_OF[0] if stopping_rule.limit_irradiance else ERROR_OF[1],
        "stopped_by": outcome.stop_reason,
        "max_stderr_reached": outcome.max_stderr_reached,
        "interpolation_error_bound": float(nodes.interpolation_bound.max()),
        "max_rays": request.max_rays,
        "rays": sum(level.n_rays for e in ensembles for level in e.strata),
        "ensembles": len(ensembles),
        "kernel": runner.list_kernels(ensembles),
    }
    if traced.semi_infinite:
        facts["traced_to_m"] = float(traced.planes_m[-1])
    return labelled(outcome, traced, request.wavelengths, facts)


def _nodes(index: np.ndarray, medium: Medium, stopping_rule: Goal) -> Nodes:
    """Return refractive indices to trace with: more of them where many share the rays of a band."""
    found = choose_nodes(index, medium.list_interfaces(), BIAS_SHARE * stopping_rule.max_stderr)
    if stopping_rule.band_weights is None:
        return found
    finer = choose_nodes(index, medium.list_interfaces(), BAND_BIAS_SHARE * stopping_rule.max_stderr)
    return finer if len(finer.index) <= MAX_NODES else found


def _check_depths(depth_m: Any, thickness: float) -> np.ndarray:
    """Return depths inside a sample of a thickness (m), or refuse them."""
    depths = increasing("depth_m", row_of("depth_m", depth_m, "numbers in metres"))
    if depths.size > MOST_DEPTHS:
        raise refuse("depth_m", f"{depths.size} depths", f"at most {MOST_DEPTHS}")
    hint = "top and bottom are there in any case"
    # Rounding leaves what is meant as the bottom on either side of it.
    bottom = np.isclose(depths, thickness, rtol=ROUNDING, atol=0.0)
    depths = np.where(bottom, thickness, depths)
    return check_each(
        "depth_m", depths, 0.0, thickness, "m", open_low=True, open_high=True, hint=hint
    )


def _check_memory(traced_medium: Traced, n_layers: int, n_nodes: int) -> None:
    """Refuse what would not fit into memory."""
    rows, columns = traced_medium.constants.absorption.shape
    wavelengths, sums = traced_medium.n_wavelengths, GROUPS * n_layers * (columns + 3) * rows * n_nodes
    if sums > MOST_SUMS:
        raise refuse(
            "wavelength_nm", f"{wavelengths} wavelengths",
            f"at most {max(1, wavelengths * MOST_SUMS // sums)} with so many depths and layers",
            "several calls hold more",
        )  # fmt: skip
