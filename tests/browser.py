"""Pages as a browser shows them, for the tests that need one."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
NEEDS_BROWSER = pytest.mark.skipif(
    CHROMIUM is None and "REQUIRE_BROWSER" not in os.environ, reason="needs Debian's chromium"
)


def page_of(address: str, folder: Path, milliseconds: int = 2000) -> str:
    """Return the page at an address as HTML, after its scripts have run for a time."""
    assert CHROMIUM, "no chromium in PATH"
    command = [
        CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic",
        "--no-first-run", "--disable-background-networking", "--disable-component-update",
        "--disable-sync", f"--user-data-dir={folder}", f"--virtual-time-budget={milliseconds}",
        "--dump-dom", address,
    ]  # fmt: skip
    run = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=300, check=True)
    return run.stdout
