"""Run a program of benchmarks/, its lines to the terminal and to the log."""

import subprocess
import sys
from pathlib import Path

program = Path(__file__).parents[2] / "benchmarks" / snakemake.params.program
command = [sys.executable, str(program), snakemake.output[0], *snakemake.params.options]
with (
    open(snakemake.log[0], "w", encoding="utf-8") as log,
    subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process,
):
    for line in process.stdout:
        print(line, end="", file=sys.stderr, flush=True)
        print(line, end="", file=log, flush=True)
if process.returncode:
    sys.exit(f"{program.name} failed, see {snakemake.log[0]}")
