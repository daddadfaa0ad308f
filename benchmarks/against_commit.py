"""What a change of the package is worth: its times now against those as of another commit.

Both take turns in processes of their own, on one thread, and the least time of each counts, because
whatever else the machine does can only add to it.

rays       Time per ray through the media of `kernels.py` at two wavelengths, by either kernel; and
           through snow by the papers' algorithm.
spectrum   CPU time of 211 wavelengths of snow.
first      CPU time of a first spectrum, with its kernels to be compiled.

    python benchmarks/against_commit.py COMMIT [TABLE.csv]

With --quick, one round of few rays, to see that everything works; its times are no result.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from kernels import CASES

from splits.core.paths import expand_path
from splits.experiments.papers.paper_tables import write_data_frame

ROOT = Path(__file__).resolve().parents[1]
RAYS_PROGRAM = """
import json, time, splits
best = {{}}
for wavelength in {wavelengths}:
    for name, rays, settings in {ways}:
        for seed in range({repeats} + 1):
            begun = time.process_time()
            spectrum = splits.spectrophotometer(
                splits.{kind}(**{medium}), [wavelength], max_stderr=1e-6, max_rays=rays,
                threads=1, seed=seed, **settings
            )
            spent = (time.process_time() - begun) / spectrum.attrs["rays"]
            way = f"{{wavelength:g}} nm, {{name}}"
            best[way] = min(best.get(way, spent), spent) if seed else float("inf")
print(json.dumps(best))
"""
"""Without the first seed, which may have compiled."""
SPECTRUM_PROGRAM = """
import json, time, splits
wavelengths = [400.0 + 10.0 * i for i in range(211)]
total = 0.0
for seed in range({repeats} + 1):
    begun = time.process_time()
    splits.spectrophotometer(splits.Snow(), wavelengths, max_stderr={error}, threads=1, seed=seed)
    total += (time.process_time() - begun) if seed else 0.0
print(json.dumps({{"211 wavelengths": total / {repeats}}}))
"""
"""Mean over seeds, which ask for more or fewer rays."""
FIRST_CALL_PROGRAM = """
import json, time, splits
begun = time.process_time()
splits.spectrophotometer(splits.Snow(), [500.0, 900.0], max_stderr=0.05, threads=1)
print(json.dumps({"first spectrum": time.process_time() - begun}))
"""


@dataclass(frozen=True)
class CommitComparisonPlan:
    """How much to measure: rounds, repetitions in each, rays by lanes, and error."""

    n_rounds: int = 3
    n_repeats: int = 3
    n_rays: int = 16_384
    error: float = 0.001


QUICK = CommitComparisonPlan(1, 1, 512, 0.02)


def make_programs(plan: CommitComparisonPlan) -> dict[tuple[str, str], str]:
    """Return what to run, by part and case."""
    scalar = ("scalar", plan.n_rays // 8, {"kernel": "scalar"})
    ways = [scalar, ("vectorized", plan.n_rays, {"kernel": "vectorized"})]
    papers = ("papers' algorithm", plan.n_rays // 8, {"estimator": "analog"})
    found = {}
    for case, (kind, medium, wavelengths) in CASES.items():
        found["rays", case] = RAYS_PROGRAM.format(
            kind=kind, medium=medium, wavelengths=wavelengths, repeats=plan.n_repeats,
            ways=[*ways, papers] if not medium else ways,
        )  # fmt: skip
    representative = next(iter(CASES))
    found["spectrum", representative] = SPECTRUM_PROGRAM.format(
        repeats=plan.n_repeats, error=plan.error
    )
    found["first", representative] = FIRST_CALL_PROGRAM
    return found


def run_program(program: str, package: Path, cache: Path | None) -> dict[str, float]:
    """Return what a program prints with the package of a folder, with its kernels kept apart."""
    kept = {} if cache is None else {"XDG_CACHE_HOME": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": str(package)} | kept,
        cwd=tempfile.gettempdir(),
        check=True,
        capture_output=True,
        text=True,
    )
    return json.loads(done.stdout)


def compare_commits(commit: str, plan: CommitComparisonPlan) -> pd.DataFrame:
    """Return the table, printed as it comes."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        before = Path(folder) / "before"
        subprocess.run(["git", "clone", "-q", str(ROOT), str(before)], check=True)
        subprocess.run(["git", "-C", str(before), "checkout", "-q", commit], check=True)
        for (part, case), program in make_programs(plan).items():
            best: dict[tuple[str, str], float] = {}
            for turn in range(plan.n_rounds):
                for when, package in (("then", before), ("now", ROOT)):
                    cache = Path(folder) / f"{when}{turn}" if part == "first" else None
                    for way, spent in run_program(program, package, cache).items():
                        best[way, when] = min(best.get((way, when), np.inf), spent)
            for way in dict.fromkeys(way for way, _ in best):
                now, then = best[way, "now"], best[way, "then"]
                rows.append(
                    {
                        "part": part, "case": case, "way": way, "seconds": now,
                        "compared_with": commit, "compared_seconds": then, "speedup": then / now,
                    }
                )  # fmt: skip
                print(
                    f"{case}, {way}: {now:.4g} s now, {then:.4g} s then, "
                    f"{then / now:.2f} times as fast",
                    flush=True,
                )
    return pd.DataFrame(rows)


def main() -> None:
    """Measure and print, and write the table if a path is given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("commit", help="to compare with")
    parser.add_argument("table", nargs="?", type=expand_path, help="CSV to write")
    parser.add_argument("--quick", action="store_true", help="a trial: few rays, one round")
    given = parser.parse_args()
    table = compare_commits(given.commit, QUICK if given.quick else CommitComparisonPlan())
    if given.table:
        write_data_frame(table, given.table)


if __name__ == "__main__":
    main()
