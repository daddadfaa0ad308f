"""Whether datasets follow the CF conventions, as the IOOS compliance checker judges them.

python tests/compliance.py results/data     every dataset of a run, and how many of them are good

Every remark counts, be it an error, a warning or a recommendation.  The checker reads its own
table of standard names and needs no network.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

CHECKER = "cf:1.11"


def remarks(paths):
    """Return what the checker says against each dataset, by path."""
    from compliance_checker.suite import CheckSuite

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of other checkers than ours
        CheckSuite.load_all_available_checkers()
    suite = CheckSuite()
    found = {}
    for path in paths:
        dataset = suite.load_dataset(str(path))
        results, failures = suite.run_all(dataset, [CHECKER])[CHECKER]
        dataset.close()
        # A check that breaks off is none that is passed.
        found[path] = [f"{name}: {error}" for name, (error, _) in failures.items()]
        for result in results:
            passed, of = result.value if isinstance(result.value, tuple) else (result.value, True)
            # What is passed may have messages, too, of what was found.
            if passed != of:
                found[path] += result.msgs or [f"{result.name}: {passed} of {of}"]
    return found


def main(folders):
    """Print what is wrong with the datasets of folders, and return whether anything is."""
    paths = sorted(path for folder in folders for path in Path(folder).rglob("*.nc"))
    found = remarks(paths)
    for path, lines in found.items():
        for line in lines:
            print(f"{path}: {line}")
    wrong = sum(bool(lines) for lines in found.values())
    print(f"{CHECKER}: {len(paths)} datasets, {wrong} with remarks")
    return wrong > 0 or not paths


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
