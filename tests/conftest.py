"""Settings of all tests, and the folders of modules that tests import from one another."""

from __future__ import annotations

import gc
import sys
from pathlib import Path

import numba

for folder in ("", "statistics", "unit", "campaigns", "../docs"):
    sys.path.insert(0, str((Path(__file__).parent / folder).resolve()))

# Compilers leave a gigabyte of objects that stay: to look through all of them again and again took
# a tenth of the time.
gc.set_threshold(50_000, 20, 20)


def pytest_configure(config):
    if numba.config.DISABLE_JIT:
        # The random stream wraps around 2**64 on purpose; NumPy scalars warn, machine code does
        # not, and pytest would turn the warning into an error.
        config.addinivalue_line("filterwarnings", "ignore:overflow encountered:RuntimeWarning")
