"""Run a program of benchmarks/ with its output in the terminal and the log (snakemake script)."""

import subprocess
import sys
from pathlib import Path

from splits.core.progress import open_progress_log

name, *options = snakemake.params.call
program = Path(__file__).parents[2] / "benchmarks" / name
command = [sys.executable, str(program), snakemake.output[0], *options]
with (
    open_progress_log(snakemake.log[0]) as log,
    subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process,
):
    for line in process.stdout:
        log(line.rstrip("\n"))
if process.returncode:
    sys.exit(f"{name} failed, see {snakemake.log[0]}")
