"""Speed of the vectorized kernel: against the scalar kernel, on two cores, and by feature.

All times are from one run, after warm-ups that compile.  The compared cases alternate, and the
shortest time of each is reported, because other load of the machine only adds to a time.

vectorized_against_scalar
    Time per ray through the same medium with the same optics, on one core, with as many rays per
    call as in a long run of an instrument.  Paths are long at 500 nm and short in the near
    infrared; long paths leave lanes idle.  `events_per_ray` is the number of segments through the
    pore space.
two_cores
    211 wavelengths on two cores and on one.  At the end of a round one core waits for the other,
    which costs less for smaller errors.
features
    Time per sampled grain at 500 nm, relative to dry snow of smooth grains.  "unused" features are
    compiled in but not needed in the scene, which gives the cost of their instructions.  Facets and
    the features of the last scenes are used, which adds to the work.

    python benchmarks/kernels.py [TABLE.csv]

`against_commit.py` compares the package with another commit.  With --quick, few rays and one round
test that the program runs; its times are not meaningful.
"""

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

import splits
from splits.core.escaping import write_data_frame
from splits.core.process import count_cpus
from splits.core.validation import expand_path
from splits.kernels import vectorized
from splits.kernels.records import allocate_exits
from splits.kernels.scene import NO_MAX_ORDER, Features, Optics, make_bounding_optics
from splits.kernels.transport import history
from splits.kernels.vectorized.trace import select_features
from splits.materials.library import absorption_coefficient
from splits.simulation.scene import build_scene

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
"""Media: kind, parameters and two wavelengths (nm), with long and with short paths."""
SMOOTH_GRAINS = {"facetness": (0, 0, 0, 0), "saturation": 0}
ROUGH_GRAINS = SMOOTH_GRAINS | {"facetness": (0.2, 0.4, 0.3, 0.072)}
OPTIONAL_FEATURES = {
    "water": "wet",
    "extinction in reflection": "absorbing",
    "mixed types, coatings": "mixed",
}
"""Features that can be compiled for a scene without them.  Facets cannot: without roughness,
near-grazing rays would be rejected about 1/cosine times."""
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
    """Size of the benchmark: rounds, rays per call, seconds per timing, errors and spectra."""

    n_rounds: int = 7
    n_rays: int = 16_384
    seconds: float = 0.5
    errors: tuple[float, ...] = (0.001, 0.0005)
    n_spectra: int = 3


QUICK = KernelBenchmarkPlan(1, 512, 0.05, (0.01,), 1)


class KernelTimer:
    """Timer of one kernel in one scene.

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
        """Trace rays from number `first` on, and return the number of their segments."""
        work = np.array([[0, first, self.n_rays, NO_MAX_ORDER]])
        if self.features is None:
            result = history.trace_rays(seed, work[0], self.scene, self.optics, self.exits, None)
        else:
            optics = Optics(*(values[np.newaxis] for values in self.optics))
            result = vectorized.trace_rays(
                seed, work, self.scene, optics, self.exits, self.features
            )
        if result.lost:
            raise RuntimeError("a ray was lost")
        return int(np.sum(result.n_segments))

    def prepare(self, plan: KernelBenchmarkPlan) -> None:
        """Compile, and choose the number of calls of a timing."""
        self.n_rays = plan.n_rays if self.features else plan.n_rays // 8
        self.exits = allocate_exits(self.n_rays, self.optics.n.size)
        self.trace(0, 0)
        start = time.perf_counter()
        self.trace(0, self.n_rays)
        time_s = time.perf_counter() - start
        self.n_calls = max(1, round(plan.seconds / time_s))

    def time_calls(self, seed: int) -> None:
        """Time all calls once and keep the shortest times."""
        start = time.perf_counter()
        n_segments = sum(self.trace(seed, number * self.n_rays) for number in range(self.n_calls))
        time_s = time.perf_counter() - start
        rays = self.n_calls * self.n_rays
        self.time_per_ray_s = min(self.time_per_ray_s, time_s / rays)
        self.time_per_segment_s = min(self.time_per_segment_s, time_s / n_segments)
        self.segments_per_ray = n_segments / rays


def compute_optics(medium: Any, wavelength_nm: float) -> Optics:
    """Return the optics of a medium at a wavelength."""
    index = medium.compute_refractive_indices(np.array([wavelength_nm]))[0]
    return make_bounding_optics(index, absorption_coefficient(index, wavelength_nm)[np.newaxis])


def get_features(medium: Any, wavelength_nm: float) -> Features:
    """Return the features of the vectorized kernel that a medium needs."""
    features = select_features(
        build_scene(medium, 0.0, False), compute_optics(medium, wavelength_nm)
    )
    if features is None:
        raise RuntimeError("the vectorized kernel does not support this medium")
    return features


def time_in_turn(timers: Mapping[str, KernelTimer], plan: KernelBenchmarkPlan) -> None:
    """Time all cases alternately, for all rounds."""
    for timer in timers.values():
        timer.prepare(plan)
    for seed in range(1, plan.n_rounds + 1):
        for timer in timers.values():
            timer.time_calls(seed)


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
    """Compare times per ray of the vectorized and the scalar kernel, and return the rows."""
    print("vectorized against scalar kernel, one core, same medium and optics", flush=True)
    rows = []
    for name, (kind, settings, wavelengths) in CASES.items():
        medium = getattr(splits, kind)(**settings)
        for wavelength in wavelengths:
            pair = {
                "scalar": KernelTimer(medium, wavelength, None),
                "vectorized": KernelTimer(medium, wavelength, get_features(medium, wavelength)),
            }
            time_in_turn(pair, plan)
            scalar, fast = pair["scalar"], pair["vectorized"]
            rows.append(
                make_row(
                    "vectorized_against_scalar", name, "s per ray", fast.time_per_ray_s, "scalar",
                    scalar.time_per_ray_s, wavelength_nm=wavelength,
                    events_per_ray=scalar.segments_per_ray,
                )
            )  # fmt: skip
            print(
                f"  {name}, {wavelength:g} nm: {scalar.segments_per_ray:.0f} events per ray; "
                f"scalar {1e6 * scalar.time_per_ray_s:.3g} µs per ray, "
                f"{1e9 * scalar.time_per_segment_s:.0f} ns per event; "
                f"vectorized {1e6 * fast.time_per_ray_s:.3g} µs per ray, "
                f"{1e9 * fast.time_per_ray_s / scalar.segments_per_ray:.0f} ns per event; "
                f"{scalar.time_per_ray_s / fast.time_per_ray_s:.2f} times as fast",
                flush=True,
            )
    return rows


def compare_two_cores(plan: KernelBenchmarkPlan) -> list[dict[str, Any]]:
    """Compare two cores with one for a spectrum by the vectorized kernel, and return the rows."""
    if count_cpus() < 2:
        print("two cores against one: skipped, there is one core", flush=True)
        return []
    rows = []
    splits.spectrophotometer(splits.Snow(), WAVELENGTHS_NM, kernel="vectorized", max_rays=1)
    for error in plan.errors:
        best = {1: np.inf, 2: np.inf}
        for seed in range(plan.n_spectra):
            for threads in best:
                start = time.perf_counter()
                splits.spectrophotometer(
                    splits.Snow(), WAVELENGTHS_NM, max_stderr=error, kernel="vectorized",
                    threads=threads, seed=seed,
                )  # fmt: skip
                best[threads] = min(best[threads], time.perf_counter() - start)
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
    """Compare times per sampled grain by feature of the vectorized kernel, and return the rows."""
    timers = {}
    for name, settings in (("smooth", SMOOTH_GRAINS), ("facets", ROUGH_GRAINS)):
        medium = splits.Snow(**settings)
        features = get_features(medium, 500.0)
        timers[name] = KernelTimer(medium, 500.0, features)
        for feature, field in OPTIONAL_FEATURES.items():
            extended = features._replace(**{field: True})
            timers[f"{name}, {feature} unused"] = KernelTimer(medium, 500.0, extended)
        all_features = features._replace(**dict.fromkeys(OPTIONAL_FEATURES.values(), True))
        timers[f"{name}, all of them unused"] = KernelTimer(medium, 500.0, all_features)
    for name, medium in FEATURE_MEDIA.items():
        timers[name] = KernelTimer(medium, 500.0, get_features(medium, 500.0))
    time_in_turn(timers, plan)
    smooth_s = timers["smooth"].time_per_segment_s
    print(f"features, time per sampled grain: smooth {1e9 * smooth_s:.1f} ns", flush=True)
    for name, timer in list(timers.items())[1:]:
        print(f"  {name}: {timer.time_per_segment_s / smooth_s:.2f}", flush=True)
    return [
        make_row(
            "features", name, "s per sampled grain", timer.time_per_segment_s, "smooth", smooth_s,
            wavelength_nm=500.0,
        )
        for name, timer in timers.items()
    ]  # fmt: skip


def main() -> None:
    """Print all parts, and write the table if a path is given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", nargs="?", type=expand_path, help="CSV to write")
    parser.add_argument("--quick", action="store_true", help="test run: few rays, one round")
    arguments = parser.parse_args()
    plan = QUICK if arguments.quick else KernelBenchmarkPlan()
    parts: list[Callable[[KernelBenchmarkPlan], list[dict[str, Any]]]] = [
        compare_with_scalar,
        compare_two_cores,
        compare_features,
    ]
    rows = [row for part in parts for row in part(plan)]
    if arguments.table:
        write_data_frame(pd.DataFrame(rows), arguments.table)


if __name__ == "__main__":
    main()
