"""Interrupted workflows end promptly, leave no results, and the next run completes."""

import os
import signal
import subprocess
import sys
import time

import pytest

import splits

pytestmark = [
    pytest.mark.long,
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
"""Time limit on a loaded machine; the simulation would take minutes."""


def list_processes(group):
    """Return the processes of a process group that still run."""
    listed = subprocess.run(
        ["ps", "-A", "-o", "pgid=,stat=,args="], capture_output=True, text=True, check=True
    )
    rows = (line.split(None, 2) for line in listed.stdout.splitlines())
    return [row for row in rows if row[0] == str(group) and not row[1].startswith("Z")]


@pytest.fixture
def simulating(project):
    """Return a project and its running workflow after the start of the simulation."""
    project.put("long", LONG)
    process = subprocess.Popen(
        project.command("--cores", 2), env=project.environment, cwd=project.folder, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
        # Background processes of a shell inherit an ignored SIGINT.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    try:
        output = []
        while "first round" not in (line := process.stdout.readline()):
            assert line, "".join(output)
            output.append(line)
        yield project, process
    finally:
        if list_processes(process.pid):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


@pytest.mark.parametrize("target", ["all", "snakemake alone"])
def test_interrupted_run_ends_promptly_and_next_run_completes(target, simulating):
    project, process = simulating
    start = time.monotonic()
    send = os.kill if target == "snakemake alone" else os.killpg
    send(process.pid, signal.SIGINT)
    output, _ = process.communicate(timeout=60)
    while list_processes(process.pid):
        assert time.monotonic() - start < PROMPT_S
        time.sleep(0.1)
    assert time.monotonic() - start < PROMPT_S
    assert process.returncode != 0
    assert output.count("long: interrupted\n") == 1 and "Traceback" not in output
    assert project.results() == []
    project.put("long", SHORT)
    run = project.snakemake(DATA, "--cores", 2)
    assert run.code == 0, run.text
    assert splits.load(project.folder / DATA).attrs["rays"] >= 20_000
