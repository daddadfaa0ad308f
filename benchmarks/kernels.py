"""What the lane kernel is worth: against the scalar one, on two cores, and feature by feature.

Everything is measured in this one run, after warm-ups that compile; rivals take turns and the
least time of each counts, because whatever else the machine does can only add to it.

vectorized_against_scalar
    Time per ray through the same medium with the same optics, one core, as many rays at a time as
    the instruments trace in a long run.  Paths are long at 500 nm and short in the near infrared;
    lanes suffer from stragglers.  `events_per_ray` are legs through the pore space.
two_cores
    211 wavelengths on two cores and on one; the smaller the error asked for, the less the ends of
    rounds matter, where one core waits for the other.
features
    Time per grain drawn at 500 nm, in dry snow of smooth grains as 1.  "unused" has the feature
    compiled in but nothing to do in the scene: the price of its instructions.  Facets, and the last
    scenes, are in use, which is work besides.

    python benchmarks/kernels.py [TABLE.csv]

`against_commit.py` compares the package with itself as of another commit.  With --quick, few rays
and one round, to see that everything works; its times are no result.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

import splits
from splits.core.paths import expand_path
from splits.experiments.papers.paper_tables import write_data_frame
from splits.kernels import vectorized
from splits.kernels.compiler.features import Features
from splits.kernels.grains import history
from splits.kernels.grains.scene import NO_MAX_ORDER, Optics, make_bounding_optics
from splits.kernels.tallies.exits import allocate_exits
from splits.kernels.vectorized.eligibility import select_features
from splits.materials.lookup import absorption_coefficient
from splits.simulation.scene import build_scene
from splits.simulation.threads import count_cpus

WAVELENGTHS_NM = np.arange(400, 2501, 10)
CASES: dict[str, tuple[str, dict[str, Any], tuple[float, float]]] = {
    "snow, representative": ("Snow", {}, (500.0, 1300.0)),
    "snow, coarse wet": (
        "Snow", {"grain_size_um": (900, 1000), "saturation": 0.3}, (500.0, 1300.0),
    ),
    "snow, thin layer": (
        "Snow", {"depth_m": 0.02, "grain_size_um": (100, 200), "saturation": 0}, (500.0, 1300.0),
    ),
    "snow, smooth dry": ("Snow", {"facetness": (0, 0, 0, 0), "saturation": 0}, (500.0, 1300.0)),
    "sand, Fig 8 base": ("Sand", {"texture": (0.0, 0.10, 0.90)}, (500.0, 900.0)),
    "sand, eight types, wet": (
        "Sand",
        {
            "hematite_ratio": 0.5, "magnetite": 0.05, "saturation": 0.3,
            "texture": (0.01, 0.09, 0.90),
        },
        (500.0, 900.0),
    ),
}  # fmt: skip
"""Media: kind, parameters and two wavelengths (nm), of long paths and of short ones."""
SMOOTH_GRAINS = {"facetness": (0, 0, 0, 0), "saturation": 0}
ROUGH_GRAINS = SMOOTH_GRAINS | {"facetness": (0.2, 0.4, 0.3, 0.072)}
OPTIONAL_FEATURES = {
    "water": "wet",
    "extinction in reflection": "absorbing",
    "mixed types, coatings": "mixed",
}
"""Features that can be on in a scene without them.  Facets cannot: without roughness, near-grazing
rays would be refused about 1/cosine times."""
FEATURE_MEDIA = {
    "facets, S = 0.3": splits.Snow(**ROUGH_GRAINS | {"saturation": 0.3}),
    "facets, entry projected": splits.Snow(
        **ROUGH_GRAINS, interpretation={"entry_point": "projected"}
    ),
    "sand, mixed particles only": splits.Sand(partition=(0.0, 1.0, 0.0), texture=(0.0, 0.10, 0.90)),
    "sand, Fig 8 base": splits.Sand(texture=(0.0, 0.10, 0.90)),
}


@dataclass(frozen=True)
class KernelBenchmarkPlan:
    """How much to measure: rounds, rays per call, seconds per timing, error and spectra."""

    n_rounds: int = 7
    n_rays: int = 16_384
    seconds: float = 0.5
    errors: tuple[float, ...] = (0.001, 0.0005)
    n_spectra: int = 3


QUICK = KernelBenchmarkPlan(1, 512, 0.05, (0.01,), 1)


class KernelTimer:
    """One kernel in one scene.

    Parameters
    ----------
    medium : GranularMedium
    wavelength_nm : float
    features : Features or None
        None for the scalar kernel.
    """

    def __init__(self, medium: Any, wavelength_nm: float, features: Features | None) -> None:
        self.scene = build_scene(medium, 0.0, False)
        self.optics = compute_optics(medium, wavelength_nm)
        self.features = features
        self.n_rays = self.n_calls = 1
        self.exits = allocate_exits(1, self.optics.n.size)
        self.time_per_ray_s = self.time_per_segment_s = np.inf
        self.segments_per_ray = np.nan

    def trace(self, seed: int, first: int) -> int:
        """Trace rays from one of that number on and return their legs."""
        work = np.array([[0, first, self.n_rays, NO_MAX_ORDER]])
        if self.features is None:
            told = history.trace_batch(
                seed, work[0], self.scene, self.optics, self.exits, None, None
            )
        else:
            optics = Optics(*(values[np.newaxis] for values in self.optics))
            told = vectorized.trace_batch(seed, work, self.scene, optics, self.exits, self.features)
        if told.lost:
            raise RuntimeError("a ray was lost")
        return int(np.sum(told.n_segments))

    def prepare(self, plan: KernelBenchmarkPlan) -> None:
        """Compile, and choose how many calls make a timing of the length planned."""
        self.n_rays = plan.n_rays if self.features else plan.n_rays // 8
        self.exits = allocate_exits(self.n_rays, self.optics.n.size)
        self.trace(0, 0)
        begun = time.perf_counter()
        self.trace(0, self.n_rays)
        spent = time.perf_counter() - begun
        self.n_calls = max(1, round(plan.seconds / spent))

    def time_calls(self, seed: int) -> None:
        """Time all calls once and keep the least times."""
        begun = time.perf_counter()
        legs = sum(self.trace(seed, number * self.n_rays) for number in range(self.n_calls))
        spent = time.perf_counter() - begun
        rays = self.n_calls * self.n_rays
        self.time_per_ray_s = min(self.time_per_ray_s, spent / rays)
        self.time_per_segment_s = min(self.time_per_segment_s, spent / legs)
        self.segments_per_ray = legs / rays


def compute_optics(medium: Any, wavelength_nm: float) -> Optics:
    """Return the optics of a medium at a wavelength."""
    index = medium.compute_refractive_indices(np.array([wavelength_nm]))[0]
    return make_bounding_optics(index, absorption_coefficient(index, wavelength_nm)[np.newaxis])


def get_features(medium: Any, wavelength_nm: float) -> Features:
    """Return what lanes need for a medium."""
    features = select_features(
        build_scene(medium, 0.0, False), compute_optics(medium, wavelength_nm)
    )
    if features is None:
        raise RuntimeError("lanes do not serve this medium")
    return features


def time_in_turn(timers: Mapping[str, KernelTimer], plan: KernelBenchmarkPlan) -> None:
    """Time all benches in turn, for all rounds."""
    for bench in timers.values():
        bench.prepare(plan)
    for seed in range(1, plan.n_rounds + 1):
        for bench in timers.values():
            bench.time_calls(seed)


def make_row(
    part: str,
    case: str,
    unit: str,
    seconds: float,
    reference: str,
    reference_s: float,
    **facts: float,
) -> dict[str, Any]:
    """Return a row of the table."""
    return {
        "part": part,
        "case": case,
        "wavelength_nm": facts.get("wavelength_nm", np.nan),
        "unit": unit,
        "seconds": seconds,
        "compared_with": reference,
        "compared_seconds": reference_s,
        "relative_time": seconds / reference_s,
        "speedup": reference_s / seconds,
        "events_per_ray": facts.get("events_per_ray", np.nan),
    }


def compare_with_scalar(plan: KernelBenchmarkPlan) -> list[dict[str, Any]]:
    """Return lanes against the scalar kernel, time per ray."""
    print("lanes against scalar, one core, the same medium and optics", flush=True)
    rows = []
    for name, (kind, settings, wavelengths) in CASES.items():
        medium = getattr(splits, kind)(**settings)
        for wavelength in wavelengths:
            pair = {
                "scalar": KernelTimer(medium, wavelength, None),
                "vectorized": KernelTimer(medium, wavelength, get_features(medium, wavelength)),
            }
            time_in_turn(pair, plan)
            scalar, lane = pair["scalar"], pair["vectorized"]
            rows.append(
                make_row(
                    "vectorized_against_scalar", name, "s per ray", lane.time_per_ray_s, "scalar",
                    scalar.time_per_ray_s, wavelength_nm=wavelength,
                    events_per_ray=scalar.segments_per_ray,
                )
            )  # fmt: skip
            print(
                f"  {name}, {wavelength:g} nm: {scalar.segments_per_ray:.0f} events per ray; "
                f"scalar {1e6 * scalar.time_per_ray_s:.3g} µs per ray, "
                f"{1e9 * scalar.time_per_segment_s:.0f} ns per event; "
                f"lanes {1e6 * lane.time_per_ray_s:.3g} µs per ray, "
                f"{1e9 * lane.time_per_ray_s / scalar.segments_per_ray:.0f} ns per event; "
                f"{scalar.time_per_ray_s / lane.time_per_ray_s:.2f} times as fast",
                flush=True,
            )
    return rows


def compare_two_cores(plan: KernelBenchmarkPlan) -> list[dict[str, Any]]:
    """Return two cores against one, for a spectrum by lanes."""
    if count_cpus() < 2:
        print("two cores against one: left out, there is one core", flush=True)
        return []
    rows = []
    splits.spectrophotometer(splits.Snow(), WAVELENGTHS_NM, kernel="vectorized", max_rays=1)
    for error in plan.errors:
        best = {1: np.inf, 2: np.inf}
        for seed in range(plan.n_spectra):
            for threads in best:
                begun = time.perf_counter()
                splits.spectrophotometer(
                    splits.Snow(), WAVELENGTHS_NM, max_stderr=error, kernel="vectorized",
                    threads=threads, seed=seed,
                )  # fmt: skip
                best[threads] = min(best[threads], time.perf_counter() - begun)
        print(
            f"two cores against one, {WAVELENGTHS_NM.size} wavelengths, error {error:g}, best of "
            f"{plan.n_spectra}: {best[1]:.2f} s on one, {best[2]:.2f} s on two, "
            f"{best[1] / best[2]:.2f} times as fast",
            flush=True,
        )
        case = f"snow, representative, error {error:g}"
        rows.append(make_row("two_cores", case, "s per spectrum", best[2], "one core", best[1]))
    return rows


def compare_features(plan: KernelBenchmarkPlan) -> list[dict[str, Any]]:
    """Return what each feature of the lane kernel costs per grain drawn."""
    benches = {}
    for name, settings in (("smooth", SMOOTH_GRAINS), ("facets", ROUGH_GRAINS)):
        medium = splits.Snow(**settings)
        bare = get_features(medium, 500.0)
        benches[name] = KernelTimer(medium, 500.0, bare)
        for feature, field in OPTIONAL_FEATURES.items():
            with_it = bare._replace(**{field: True})
            benches[f"{name}, {feature} unused"] = KernelTimer(medium, 500.0, with_it)
        everything = bare._replace(**dict.fromkeys(OPTIONAL_FEATURES.values(), True))
        benches[f"{name}, all of them unused"] = KernelTimer(medium, 500.0, everything)
    for name, medium in FEATURE_MEDIA.items():
        benches[name] = KernelTimer(medium, 500.0, get_features(medium, 500.0))
    time_in_turn(benches, plan)
    one = benches["smooth"].time_per_segment_s
    print(f"features, time per grain drawn: smooth {1e9 * one:.1f} ns", flush=True)
    for name, bench in list(benches.items())[1:]:
        print(f"  {name}: {bench.time_per_segment_s / one:.2f}", flush=True)
    return [
        make_row(
            "features", name, "s per grain drawn", bench.time_per_segment_s, "smooth", one,
            wavelength_nm=500.0,
        )
        for name, bench in benches.items()
    ]  # fmt: skip


def main() -> None:
    """Measure and print, and write the table if a path is given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", nargs="?", type=expand_path, help="CSV to write")
    parser.add_argument("--quick", action="store_true", help="a trial: few rays, one round")
    given = parser.parse_args()
    plan = QUICK if given.quick else KernelBenchmarkPlan()
    parts: list[Callable[[KernelBenchmarkPlan], list[dict[str, Any]]]] = [
        compare_with_scalar,
        compare_two_cores,
        compare_features,
    ]
    rows = [one for part in parts for one in part(plan)]
    if given.table:
        write_data_frame(pd.DataFrame(rows), given.table)


if __name__ == "__main__":
    main()
