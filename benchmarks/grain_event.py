"""What one grain event costs: in sand against snow, and in snow against another commit.

An event is a leg through the pore space and the walk through the grain at its end.  Media are
timed in turn, several times over, on one thread, after a warm-up that compiles the kernels; the
least time of each counts, because whatever else the machine does can only add to it.  With
`--against COMMIT` the same snow is timed in alternation with the package as of that commit, by
the time of a whole spectrum's rays, in processes of their own.

    python benchmarks/grain_event.py [--against COMMIT] [--rounds 7]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ONE_SNOW = """
import time, splits
best = []
for round in range({rounds} + 1):
    begun = time.perf_counter()
    splits.spectrophotometer(splits.Snow(), [500.0], max_stderr=1e-6, max_rays=1500, threads=1)
    best.append(time.perf_counter() - begun)
print(min(best[1:]))
"""


def media() -> dict[str, object]:
    """Return the media to time, by name."""
    import splits

    coated = {"iron_oxide": 0.05, "hematite_ratio": 0.359, "partition": (0.5, 0.0, 0.5)}
    return {
        "snow, Table 1": splits.Snow(),
        "sand, Fig 8 base": splits.Sand(texture=(0.0, 0.10, 0.90)),
        "sand, coated (TEC 10039240)": splits.Sand(**coated),
        "sand, eight types, wet": splits.Sand(
            hematite_ratio=0.5, magnetite=0.05, saturation=0.3, texture=(0.01, 0.09, 0.90)
        ),
    }


def seconds_per_event(medium: object, rays: int, ensemble: int) -> float:
    """Return the time per leg (s) of rays at 600 nm through a medium as it is."""
    import numpy as np

    from splits.materials.refractive_index import absorption_coefficient
    from splits.transport.granular import batch
    from splits.transport.scene import Optics, Slab

    index = medium.indices(np.array([600.0]))[0]
    absorption = absorption_coefficient(index, 600.0)
    optics = Optics(index.real.copy(), index.imag.copy(), absorption)
    slab = Slab(medium.depth_m, float(medium.saturation), 1.0, False)
    grains, rules = medium.grains(), medium.readings.rules()
    begun = time.perf_counter()
    tally = batch(1, ensemble, 0, rays, grains, slab, rules, optics, absorption[np.newaxis])
    return (time.perf_counter() - begun) / tally[2]


def compare_media(rounds: int) -> None:
    """Print the cost of an event in every medium and its ratio to snow."""
    chosen = media()
    best = dict.fromkeys(chosen, float("inf"))
    for ensemble in range(rounds + 1):
        for name, medium in chosen.items():
            rays = 300 if name.startswith("snow") else 6000
            spent = seconds_per_event(medium, rays, ensemble)
            if ensemble > 0:
                best[name] = min(best[name], spent)
    snow = next(iter(best.values()))
    for name, spent in best.items():
        print(f"{name}: {1e9 * spent:.0f} ns per event, {spent / snow:.2f} times snow", flush=True)


def compare_commits(commit: str, rounds: int) -> None:
    """Print the time of the same rays through snow now and as of another commit."""
    with tempfile.TemporaryDirectory() as folder:
        before = Path(folder) / "before"
        subprocess.run(["git", "clone", "-q", str(ROOT), str(before)], check=True)
        subprocess.run(["git", "-C", str(before), "checkout", "-q", commit], check=True)
        best = {"before": float("inf"), "now": float("inf")}
        for _ in range(rounds):
            for name, path in (("before", before), ("now", ROOT)):
                done = subprocess.run(
                    [sys.executable, "-c", ONE_SNOW.format(rounds=3)],
                    env={**os.environ, "PYTHONPATH": str(path)},
                    cwd=folder,
                    check=True,
                    capture_output=True,
                    text=True,
                )
                best[name] = min(best[name], float(done.stdout))
    ratio = best["now"] / best["before"]
    print(
        f"the same rays through snow: {best['before']:.3f} s at {commit}, {best['now']:.3f} s now, "
        f"ratio {ratio:.3f}"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", metavar="COMMIT")
    parser.add_argument("--rounds", type=int, default=7)
    given = parser.parse_args()
    compare_media(given.rounds)
    if given.against:
        compare_commits(given.against, given.rounds)


if __name__ == "__main__":
    main()
