"""Import paths, garbage collection and warning filters of all tests."""

import gc
import sys
from pathlib import Path

import numba

for folder in ("", "statistics", "unit", "physics", "campaigns", "../docs", ".."):
    sys.path.insert(0, str((Path(__file__).parent / folder).resolve()))

# Compilation leaves a gigabyte of live objects; repeated collection of all generations took a tenth
# of the time.
gc.set_threshold(50_000, 20, 20)


def pytest_configure(config):
    if numba.config.DISABLE_JIT:
        # The random stream wraps around 2**64 on purpose; NumPy scalars warn, machine code does
        # not, and pytest would turn the warning into an error.
        config.addinivalue_line("filterwarnings", "ignore:overflow encountered:RuntimeWarning")
