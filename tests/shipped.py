"""The shipped configuration in a folder of its own, without files that users add to config/."""

import shutil
import subprocess
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]


def list_shipped_files() -> list[str]:
    """Return the files of config/ that belong to the repository, all of them outside one."""
    command = ["git", "-C", str(ROOT), "ls-files", "-z", "config"]
    try:
        listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        listed = ""
    files = [name for name in listed.split("\0") if name and (ROOT / name).is_file()]
    everything = (path for path in (ROOT / "config").rglob("*") if path.is_file())
    return files or [path.relative_to(ROOT).as_posix() for path in everything]


_FOLDER = tempfile.TemporaryDirectory()
CONFIG = Path(_FOLDER.name) / "config"
for _name in list_shipped_files():
    _copy = Path(_FOLDER.name) / _name
    _copy.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(ROOT / _name, _copy)
