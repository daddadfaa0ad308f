"""What all tests share: the judgement of statistics in tests/statistics/chi2.py is importable.

So are the generators of experiment files in tests/campaigns.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numba

for folder in ("", "statistics", "campaigns"):
    sys.path.insert(0, str(Path(__file__).parent / folder))


def pytest_configure(config):
    if numba.config.DISABLE_JIT:
        # The random stream wraps around 2**64 on purpose; NumPy scalars warn, machine code does
        # not, and pytest would turn the warning into an error.
        config.addinivalue_line("filterwarnings", "ignore:overflow encountered:RuntimeWarning")
