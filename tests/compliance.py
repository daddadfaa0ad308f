"""Compliance of datasets with the CF conventions, by the IOOS compliance checker.

    python tests/compliance.py results/data

checks every dataset of a run.  Errors, warnings and recommendations all count as remarks.  The
checker uses its own table of standard names and needs no network.
"""

import sys
import warnings
from pathlib import Path

CHECKER = "cf:1.11"


def collect_remarks(paths):
    """Return the remarks of the checker on each dataset, by path."""
    from compliance_checker.suite import CheckSuite

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of other checkers
        CheckSuite.load_all_available_checkers()
    suite = CheckSuite()
    remarks = {}
    for path in paths:
        dataset = suite.load_dataset(str(path))
        results, errors = suite.run_all(dataset, [CHECKER])[CHECKER]
        dataset.close()
        # A check that raises an error counts as failed.
        remarks[path] = [f"{name}: {error}" for name, (error, _) in errors.items()]
        for result in results:
            passed, total = (
                result.value if isinstance(result.value, tuple) else (result.value, True)
            )
            # A passed check may also have messages.
            if passed != total:
                remarks[path] += result.msgs or [f"{result.name}: {passed} of {total}"]
    return remarks


def main(folders):
    """Print the remarks on the datasets of folders, and return whether there are any."""
    paths = sorted(path for folder in folders for path in Path(folder).rglob("*.nc"))
    remarks = collect_remarks(paths)
    for path, lines in remarks.items():
        for line in lines:
            print(f"{path}: {line}")
    n_failed = sum(bool(lines) for lines in remarks.values())
    print(f"{CHECKER}: {len(paths)} datasets, {n_failed} with remarks")
    return n_failed > 0 or not paths


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
