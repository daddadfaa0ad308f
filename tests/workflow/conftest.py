"""Fixtures of workflow tests: projects with a copy of config/ and the shipped Snakefile."""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from shipped import CONFIG

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Run:
    """Exit code and output of a run of Snakemake."""

    code: int
    text: str

    def jobs(self):
        """Return the messages of all jobs, such as "Simulating first", sorted."""
        return sorted(re.findall(r"^Job \d+: (.*)$", self.text, re.MULTILINE))


class Project:
    """A working directory with its own configuration."""

    def __init__(self, folder, environment, snakefile=ROOT / "Snakefile"):
        self.folder = folder
        self.environment = environment
        self.snakefile = snakefile

    def put(self, name, text):
        """Write an experiment file."""
        path = self.folder / "config" / "experiments" / f"{name}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")

    def command(self, *arguments, config="accuracy=tiny"):
        """Return the command that runs the shipped workflow in this folder."""
        command = [sys.executable, "-m", "snakemake", "--snakefile", str(self.snakefile)]
        command += ["--directory", str(self.folder), *map(str, arguments)]
        return command + (["--config", *config.split()] if config else [])

    def snakemake(self, *arguments, config="accuracy=tiny"):
        """Run the shipped workflow in this folder."""
        command = self.command(*arguments, config=config)
        done = subprocess.run(
            command, env=self.environment, capture_output=True, text=True, cwd=self.folder
        )
        return Run(done.returncode, done.stdout + done.stderr)

    def results(self, folder="results"):
        """Return the relative paths of all result files except logs and benchmarks."""
        top = self.folder / folder
        files = (path.relative_to(top) for path in top.rglob("*") if path.is_file())
        return sorted(
            path.as_posix() for path in files if not {"logs", "benchmarks"} & set(path.parts)
        )

    def copy(self, folder):
        """Return a copy with all results, which keep their modification times."""
        shutil.copytree(self.folder, folder, dirs_exist_ok=True)
        return Project(folder, self.environment)


@pytest.fixture(scope="session")
def environment(tmp_path_factory):
    """Return environment variables for processes of the workflow."""
    variables = {k: v for k, v in os.environ.items() if k != "NUMBA_DISABLE_JIT"}
    if variables.pop("PYTHONDONTWRITEBYTECODE", None) and "PYTHONPYCACHEPREFIX" not in variables:
        # Every job is a process: bytecode of libraries is cached rather than compiled each time.
        variables["PYTHONPYCACHEPREFIX"] = str(tmp_path_factory.mktemp("bytecode"))
    return variables


@pytest.fixture(scope="session")
def make_project(environment):
    """Return a function that makes a project, with the shipped experiments or without any."""

    def make(folder, shipped=False):
        leave_out = None if shipped else shutil.ignore_patterns("experiments")
        shutil.copytree(CONFIG, folder / "config", ignore=leave_out)
        return Project(folder, environment)

    return make


@pytest.fixture
def project(make_project, tmp_path):
    """Return an empty project."""
    return make_project(tmp_path)
