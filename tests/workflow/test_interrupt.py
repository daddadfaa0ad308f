"""A workflow that is interrupted: what runs on, what is left, and how the next run goes on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

import splits

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX"),
]

LONG = """\
title: Long
medium: {base: splitsnow_table1, depth_m: 0.02}
instrument: {kind: goniophotometer, wavelength_nm: [500], estimator: bins, rays: 200000000}
"""
SHORT = LONG.replace("200000000", "20000")
DATA = "results/tiny/data/long.nc"
PROMPT_S = 12.0
"""What a loaded machine may take; the simulation would take minutes."""


def members(group):
    """Return the processes of a group that still run."""
    listed = subprocess.run(
        ["ps", "-A", "-o", "pgid=,stat=,args="], capture_output=True, text=True, check=True
    )
    rows = (line.split(None, 2) for line in listed.stdout.splitlines())
    return [row for row in rows if row[0] == str(group) and not row[1].startswith("Z")]


@pytest.fixture
def simulating(project):
    """Return a project and its running workflow, whose simulation has begun."""
    project.put("long", LONG)
    process = subprocess.Popen(
        project.command("--cores", 2), env=project.environment, cwd=project.folder, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
        # Shells let what they start in the background ignore it.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    try:
        said = []
        while "first round" not in (line := process.stdout.readline()):
            assert line, "".join(said)
            said.append(line)
        yield project, process
    finally:
        if members(process.pid):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


@pytest.mark.parametrize("way", ["all", "snakemake alone"])
def test_an_interrupted_run_ends_soon_and_the_next_completes(way, simulating):
    project, process = simulating
    since = time.monotonic()
    send = os.kill if way == "snakemake alone" else os.killpg
    send(process.pid, signal.SIGINT)
    said, _ = process.communicate(timeout=60)
    while members(process.pid):
        assert time.monotonic() - since < PROMPT_S
        time.sleep(0.1)
    assert time.monotonic() - since < PROMPT_S
    assert process.returncode != 0
    assert said.count("long: interrupted\n") == 1 and "Traceback" not in said
    assert project.results() == []
    project.put("long", SHORT)
    run = project.snakemake(DATA, "--cores", 2)
    assert run.code == 0, run.text
    assert splits.load(project.folder / DATA).attrs["rays"] >= 20_000
