#!/usr/bin/env bash
# Build a table on the SLURM of start.sh with injected faults, and compare it with one built without:
# a job is killed, one is cancelled, the node daemon is killed with all its jobs, and snakemake is
# interrupted and restarted.  As root, in a folder with config/:
#
#   tests/cluster/faults.sh EXPERIMENT [REFERENCE.nc]
#
# EXPERIMENT is one of config/experiments with instrument table; without a reference one is made
# first, by two cores, in results/reference.
set -euo pipefail
# Each background job is its own process group, so that it receives the signal of Ctrl+C.
set -m
name=$1 host=$(hostname -s)
table=results/data/$name.nc

say() { echo "$(date +%T) $*"; }

# List the running jobs of the scheduler, one per line.
running() { squeue --noheader --states running --format %i | sort -n; }

# Wait until $1 ensembles are stored.
kept() {
    until [ "$(find "results/blocks/$name" -name '*.nc' 2>/dev/null | wc -l)" -ge "$1" ]; do
        if ! kill -0 "$made" 2>/dev/null; then
            say "snakemake has ended already"
            return
        fi
        sleep 0.5
    done
    say "$(find "results/blocks/$name" -name '*.nc' | wc -l) ensembles are kept"
}

submit() {
    snakemake --profile profiles/slurm "$table" > "snakemake.$1.log" 2>&1 &
    made=$!
}

if [ $# -lt 2 ]; then
    snakemake --cores 2 --config results=results/reference --quiet all -- "results/reference/data/$name.nc"
    set -- "$name" "results/reference/data/$name.nc"
fi
if [ -e "results/blocks/$name" ] || [ -e "$table" ]; then
    echo "results/blocks/$name and $table have to be removed first" >&2
    exit 1
fi
submit 1
kept 4
victim=$(running | head -1)
say "job $victim dies: its processes are killed with -9"
pkill -9 -f "/job0*$victim/slurm_script" || say "it has ended already"
kept 12
victim=$(running | tail -1)
say "job $victim is cancelled"
scancel "$victim" || say "it has ended already"
kept 20
say "the node daemon and all its jobs are killed with -9"
pkill -9 -x slurmd || true
pkill -9 slurmstepd || true
pkill -9 -f "jobstep|table_part" || true
sleep 5
slurmd -N "$host"
say "the node daemon is back"
kept 28
say "snakemake is interrupted, as by Ctrl+C"
kill -INT -- "-$made" || say "it has ended already"
wait "$made" || say "it ended with $?"
squeue --noheader | wc -l | xargs -I{} echo "$(date +%T) jobs left in the queue: {}"
snakemake --profile profiles/slurm --unlock "$table" > /dev/null 2>&1 || true
submit 2
wait "$made"
say "the table is there"
grep -h -i -E "Error in rule|Trying to restart|cancelled|failed with status|steps \(100" snakemake.1.log snakemake.2.log |
    sed 's/^\[.*\] *//' | cut -c 1-110 | sort | uniq -c
python - "$table" "$2" <<'PYTHON'
import sys

import numpy as np

import splits

one, other = (splits.load(path) for path in sys.argv[1:])
same = {name: np.array_equal(one[name].values, other[name].values) for name in one.data_vars}
count = one.reflectance.size // one.sizes["wavelength"]
print(f"{count} spectra of {one.sizes['wavelength']} wavelengths: same bits", same)
sys.exit(not all(same.values()))
PYTHON
