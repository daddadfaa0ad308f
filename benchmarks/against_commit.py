"""Speed of the package compared with that of another commit.

Both alternate in separate processes, on one thread.  The shortest time of each is reported, because
other load of the machine only adds to a time.

rays       Time per ray through the media of `kernels.py` at two wavelengths, with both kernels, and
           through snow with the papers' algorithm.
spectrum   CPU time of 211 wavelengths of snow.
first      CPU time of a first spectrum, including the compilation of its kernels.

    python benchmarks/against_commit.py COMMIT [TABLE.csv]

With --quick, one round of few rays tests that the program runs; its times are not meaningful.
"""

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
from splits.io.data_frame import write_data_frame

ROOT = Path(__file__).resolve().parents[1]
RAYS_PROGRAM = """
import json, time, splits
best = {{}}
for wavelength in {wavelengths}:
    for name, rays, settings in {methods}:
        for seed in range({repeats} + 1):
            start = time.process_time()
            spectrum = splits.spectrophotometer(
                splits.{kind}(**{medium}), [wavelength], max_stderr=1e-6, max_rays=rays,
                threads=1, seed=seed, **settings
            )
            time_s = (time.process_time() - start) / spectrum.attrs["rays"]
            label = f"{{wavelength:g}} nm, {{name}}"
            best[label] = min(best.get(label, time_s), time_s) if seed else float("inf")
print(json.dumps(best))
"""
"""Program of part "rays"; the first seed may compile, and is not counted."""
SPECTRUM_PROGRAM = """
import json, time, splits
wavelengths = [400.0 + 10.0 * i for i in range(211)]
total = 0.0
for seed in range({repeats} + 1):
    start = time.process_time()
    splits.spectrophotometer(splits.Snow(), wavelengths, max_stderr={error}, threads=1, seed=seed)
    total += (time.process_time() - start) if seed else 0.0
print(json.dumps({{"211 wavelengths": total / {repeats}}}))
"""
"""Program of part "spectrum"; the time is a mean because the number of rays depends on the seed."""
FIRST_CALL_PROGRAM = """
import json, time, splits
start = time.process_time()
splits.spectrophotometer(splits.Snow(), [500.0, 900.0], max_stderr=0.05, threads=1)
print(json.dumps({"first spectrum": time.process_time() - start}))
"""


@dataclass(frozen=True)
class CommitComparisonPlan:
    """Size of the benchmark: rounds, repeats per round, rays of the vectorized kernel, error."""

    n_rounds: int = 3
    n_repeats: int = 3
    n_rays: int = 16_384
    error: float = 0.001


QUICK = CommitComparisonPlan(1, 1, 512, 0.02)


def make_programs(plan: CommitComparisonPlan) -> dict[tuple[str, str], str]:
    """Return the programs to run, by part and case."""
    scalar = ("scalar", plan.n_rays // 8, {"kernel": "scalar"})
    methods = [scalar, ("vectorized", plan.n_rays, {"kernel": "vectorized"})]
    papers = ("papers' algorithm", plan.n_rays // 8, {"estimator": "analog"})
    programs = {}
    for case, (kind, medium, wavelengths) in CASES.items():
        programs["rays", case] = RAYS_PROGRAM.format(
            kind=kind, medium=medium, wavelengths=wavelengths, repeats=plan.n_repeats,
            methods=[*methods, papers] if not medium else methods,
        )  # fmt: skip
    representative = next(iter(CASES))
    programs["spectrum", representative] = SPECTRUM_PROGRAM.format(
        repeats=plan.n_repeats, error=plan.error
    )
    programs["first", representative] = FIRST_CALL_PROGRAM
    return programs


def run_program(program: str, package: Path, cache: Path | None) -> dict[str, float]:
    """Return the times that a program prints with the package and kernel cache of given folders."""
    cache_variables = {} if cache is None else {"XDG_CACHE_HOME": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": str(package)} | cache_variables,
        cwd=tempfile.gettempdir(),
        check=True,
        capture_output=True,
        text=True,
    )
    return json.loads(done.stdout)


def compare_commits(commit: str, plan: CommitComparisonPlan) -> pd.DataFrame:
    """Compare with a commit, print each row, and return the table."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        before = Path(folder) / "before"
        subprocess.run(["git", "clone", "-q", str(ROOT), str(before)], check=True)
        subprocess.run(["git", "-C", str(before), "checkout", "-q", commit], check=True)
        for (part, case), program in make_programs(plan).items():
            best: dict[tuple[str, str], float] = {}
            for turn in range(plan.n_rounds):
                for version, package in (("then", before), ("now", ROOT)):
                    cache = Path(folder) / f"{version}{turn}" if part == "first" else None
                    for method, time_s in run_program(program, package, cache).items():
                        best[method, version] = min(best.get((method, version), np.inf), time_s)
            for method in dict.fromkeys(method for method, _ in best):
                now, then = best[method, "now"], best[method, "then"]
                rows.append(
                    {
                        "part": part, "case": case, "method": method, "seconds": now,
                        "compared_with": commit, "compared_seconds": then, "speedup": then / now,
                    }
                )  # fmt: skip
                print(
                    f"{case}, {method}: {now:.4g} s now, {then:.4g} s then, "
                    f"{then / now:.2f} times as fast",
                    flush=True,
                )
    return pd.DataFrame(rows)


def main() -> None:
    """Print the comparison, and write the table if a path is given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("commit", help="to compare with")
    parser.add_argument("table", nargs="?", type=expand_path, help="CSV to write")
    parser.add_argument("--quick", action="store_true", help="test run: few rays, one round")
    arguments = parser.parse_args()
    table = compare_commits(arguments.commit, QUICK if arguments.quick else CommitComparisonPlan())
    if arguments.table:
        write_data_frame(table, arguments.table)


if __name__ == "__main__":
    main()
