"""Sources of physics: which they are, and a digest that does not depend on their place or age."""

from __future__ import annotations

import os
import shutil

from splits import sources
from splits.sources import PACKAGE, files_digest, physics_digest, physics_sources


def test_physics_is_what_numbers_depend_on():
    names = {path.as_posix() for path in physics_sources()}
    assert {"media/snow.py", "transport/lanes/batch.py", "experiments/run.py"} <= names
    assert not any(name.startswith(("figures/", "analysis/", "experiments/fit")) for name in names)
    fitting = {path.as_posix() for path in physics_sources(fit=True)} - names
    assert fitting == {"experiments/fit.py", "experiments/parameters.py", "experiments/run_fit.py"}
    assert all((PACKAGE / name).is_file() for name in names)
    assert physics_digest() != physics_digest(fit=True)


def test_the_digest_follows_contents_only(tmp_path, monkeypatch):
    copy = tmp_path / "elsewhere"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    os.utime(copy / "media" / "snow.py", (0, 0))
    assert files_digest(copy, physics_sources()) == physics_digest()
    (copy / "media" / "snow.py").write_text("changed")
    assert files_digest(copy, physics_sources()) != physics_digest()
    monkeypatch.setattr(sources, "PACKAGE", copy)
    assert set(sources.physics_sources()) == set(physics_sources())
