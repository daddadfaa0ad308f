"""Light transport kernels: numbers in, numbers out.

Nothing in this folder imports the rest of the package.  Every function is a small Numba
kernel that also runs as plain Python with ``NUMBA_DISABLE_JIT=1``.

Compiled machine code is cached between processes.  Numba only notices a change in the file that
holds a cached function, not in the files it calls, so the cache lives in a folder named after
the content of all kernel sources: edited physics can never meet stale machine code.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import warnings
from pathlib import Path

import numba


def sources_digest() -> str:
    """Return the SHA-256 (first 16 hex digits) of all kernel sources."""
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(source.name.encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _use_content_addressed_cache() -> None:
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    home = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    folder = home / "splits" / f"numba-{sources_digest()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"splits-numba-{sources_digest()}"
    numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]


_use_content_addressed_cache()

if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
    # The random stream wraps around 2**64 on purpose; NumPy scalars warn about it, machine
    # integers do not.
    warnings.filterwarnings("ignore", "overflow encountered", RuntimeWarning)
