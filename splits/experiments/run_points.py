"""The points of an experiment's grid, measured: those that share paths together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from splits.core.progress import Progress
from splits.experiments.checkpoints import PointCache
from splits.experiments.config.instrument import SURFACE_INSTRUMENTS, InstrumentSection
from splits.experiments.config.settings import Accuracy
from splits.experiments.config.simulation import SimulationConfig
from splits.instruments import (
    beam_spread,
    goniophotometer,
    lens,
    spectrophotometer,
    surface_map,
)
from splits.instruments.shared_spectra import simulate_spectra
from splits.instruments.spectral_run import SpectralRequest
from splits.io.netcdf import to_netcdf_attributes
from splits.media.medium import GranularMedium, LayeredMedium, Medium
from splits.simulation.path_reuse import MediaGroup, group_by_shared_paths

STDERR_ATTRIBUTES = ("max_stderr_reached", "relative_stderr_reached")
N_BEAM_RAYS = 200_000
"""Rays of a beam whose spread is measured, for a relative error of 0.02 elsewhere."""
MAX_RAYS = 20_000_000

LogCallback = Callable[[str], None]
GridPoint = tuple[dict[str, str], Medium, float | str]


class SimulatedPoints(NamedTuple):
    """What was measured.

    Attributes
    ----------
    datasets : list of xarray.Dataset
        Of the points, in their order.
    rays : int
        Traced for all of them; points may share some.
    """

    datasets: list[xr.Dataset]
    rays: int


def simulate_points(
    experiment: SimulationConfig,
    accuracy: Accuracy,
    seed: int,
    threads: int | None,
    log: LogCallback,
    cache: PointCache | None = None,
) -> SimulatedPoints:
    """Measure all points of an experiment but those kept, see `splits.experiments.run.run`.

    Points whose spectra need the same paths share them: those that differ in what absorbs, in the
    albedo of a ground, or in the size of everything.
    """
    instrument, points = experiment.instrument, list(experiment.iter_points())
    seed = seed if instrument.seed is None else instrument.seed
    found: dict[int, xr.Dataset] = {}
    groups = _group_by_shared_paths(instrument, points)
    if len(groups) < len(points):
        log(f"{experiment.name}: {len(groups)} ensembles of paths serve {len(points)} points")
    rays = 0
    for places, members in groups:
        head = _format_prefix(experiment.name, points, places)
        before = cache.load(places) if cache else None
        if before:
            log(f"{head}: kept from an earlier run")
            found |= dict(zip(places, before, strict=True))
            rays += int(before[0].attrs["rays"])
            continue
        show = _make_progress_callback(head, log)
        some = [points[place] for place in places]
        if members is None:
            _, medium, incidence = some[0]
            datasets = [
                simulate_point(instrument, medium, incidence, accuracy, seed, threads, show)
            ]
        else:
            datasets = _simulate_group(some, members, instrument, accuracy, seed, threads, show)
        datasets = cache.save(places, datasets) if cache else datasets
        found |= dict(zip(places, datasets, strict=True))
        rays += int(datasets[0].attrs["rays"])
        _log_result(head, datasets, instrument, log)
    return SimulatedPoints([found[place] for place in range(len(points))], rays)


def _group_by_shared_paths(
    instrument: InstrumentSection, points: Sequence[GridPoint]
) -> list[tuple[list[int], MediaGroup | None]]:
    """Return the places of points that share paths, with their family; of others none."""
    grains = all(isinstance(medium, GranularMedium | LayeredMedium) for _, medium, _ in points)
    if instrument.kind != "spectrophotometer" or instrument.estimator == "analog" or not grains:
        return [([place], None) for place in range(len(points))]
    wavelengths = np.asarray(instrument.get_wavelengths(), dtype=float)
    groups: list[tuple[list[int], MediaGroup | None]] = []
    for beam in dict.fromkeys(incidence for *_, incidence in points):
        under = [place for place, (*_, incidence) in enumerate(points) if incidence == beam]
        for members in group_by_shared_paths([points[place][1] for place in under], wavelengths):
            places = [under[place] for place in members.positions]
            groups.append((places, members if len(places) > 1 else None))
    return sorted(groups, key=lambda group: min(group[0]))


def _simulate_group(
    points: Sequence[GridPoint],
    group: MediaGroup,
    instrument: InstrumentSection,
    accuracy: Accuracy,
    seed: int,
    threads: int | None,
    progress: Callable[[Progress], None],
) -> list[xr.Dataset]:
    """Measure points that share paths, in the order of their family's members."""
    most = MAX_RAYS if accuracy.max_rays is None else accuracy.max_rays
    error = min(instrument.stderr_scale * accuracy.max_stderr, 0.5)
    _, _, beam = points[0]
    run = SpectralRequest.from_arguments(
        instrument.get_wavelengths(), beam, error, seed, most, threads, "auto"
    )
    spectra = simulate_spectra(group.path_sharing, run, progress)
    return [
        _relabel_spectrum(spectra[which], medium)
        for which, (_, medium, _) in zip(group.media_indices, points, strict=True)
    ]


def _relabel_spectrum(spectrum: xr.Dataset, medium: Medium) -> xr.Dataset:
    """Return the spectrum of a medium from that of one that is the same to light."""
    start = f"{medium.kind}_"
    told = {f"{start}{key}": value for key, value in medium.describe().items()}
    others = {key: value for key, value in spectrum.attrs.items() if not key.startswith(start)}
    return xr.Dataset(spectrum.data_vars, spectrum.coords, to_netcdf_attributes(others | told))


def _format_prefix(name: str, points: Sequence[GridPoint], indices: Sequence[int]) -> str:
    """Return how lines about some points begin."""
    if len(indices) > 1:
        return f"{name} {len(indices)} of {len(points)} together, from {min(indices) + 1}"
    (place,) = indices
    where = " ".join(f"{p}={label}" for p, label in points[place][0].items())
    return f"{name} {place + 1}/{len(points)} {where}".rstrip()


def _make_progress_callback(prefix: str, log: LogCallback) -> Callable[[Progress], None]:
    """Return what tells of progress in lines."""

    def show(progress: Progress) -> None:
        if progress.stderr >= 1.0:
            log(f"{prefix}: first round, {progress.rays} rays")
            return
        log(
            f"{prefix}: {progress.rays} rays this round, error {progress.stderr:.4f} so far "
            f"(wanted {progress.target:g}), about {progress.seconds_left:.0f} s left here"
        )

    return show


def _log_result(
    prefix: str, datasets: Sequence[xr.Dataset], instrument: InstrumentSection, log: LogCallback
) -> None:
    """Say how it went."""
    facts = datasets[0].attrs
    reached = [
        f", error {max(one.attrs[key] for one in datasets):.4f}"
        for key in STDERR_ATTRIBUTES
        if key in facts
    ]
    log(f"{prefix}: done, {facts['rays']} rays{''.join(reached)}, {facts['wall_time_s']:.1f} s")
    asked = instrument.rays or instrument.estimator == "bins"
    if facts.get("stop_reason") == "max_rays" and not asked:
        log(f"{prefix}: stopped by max_rays = {facts['max_rays']} before the error was reached")
    if facts.get("stop_reason") == "max_degree":
        log(
            f"{prefix}: stopped before the error was reached: in some directions light changes "
            "faster than the expansion can follow, which no rays mend; stated errors allow "
            "for it; `estimator: bins` shows such light"
        )


def simulate_point(
    instrument: InstrumentSection,
    medium: Medium,
    incidence_deg: float | str,
    accuracy: Accuracy,
    seed: int,
    threads: int | None,
    progress: Callable[[Progress], None],
) -> xr.Dataset:
    """Put a medium under an instrument; see `run`."""
    scene: tuple[Any, ...] = (medium, instrument.get_wavelengths(), incidence_deg)
    common: dict[str, Any] = {"seed": seed, "threads": threads, "progress": progress}
    keys = (
        "estimator", "target", "polar_deg", "azimuth_deg", "n_bins", "rays", "half_width_m",
        "radius_m", "screen_depth_m", "centre_on", "realisations",
    )  # fmt: skip
    given = {key: getattr(instrument, key) for key in keys}
    given = {key: value for key, value in given.items() if value is not None}
    if instrument.kind in SURFACE_INSTRUMENTS:
        look: Callable[..., xr.Dataset] = lens if instrument.kind == "lens" else surface_map
        return look(medium, seed=seed, **given)
    common |= given
    if instrument.kind == "beam_spread":
        effort = (0.02 / (instrument.stderr_scale * accuracy.relative_stderr)) ** 2
        common.setdefault("rays", int(np.ceil(N_BEAM_RAYS * effort)))
        return beam_spread(*scene, **common)
    if accuracy.max_rays is not None:
        common["max_rays"] = accuracy.max_rays
    if instrument.kind == "goniophotometer":
        common["relative_stderr"] = min(instrument.stderr_scale * accuracy.relative_stderr, 0.5)
        return goniophotometer(*scene, **common)
    common["max_stderr"] = min(instrument.stderr_scale * accuracy.max_stderr, 0.5)
    return spectrophotometer(*scene, **common)
