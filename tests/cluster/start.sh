#!/usr/bin/env bash
# Start a SLURM of one machine, controller and node daemon, to try profiles/slurm on. As root, with
# Debian's packages slurm-wlm and munge; needs no systemd and no database.
#
#   tests/cluster/start.sh [CPUS] [MEMORY_MB]     start both, and write /etc/slurm/slurm.conf
#   tests/cluster/start.sh stop                   stop both
set -euo pipefail

stop() {
    for daemon in slurmd slurmctld munged; do
        pkill -x "$daemon" || true
    done
}

if [ "${1:-}" = stop ]; then
    stop
    # With it, whatever asks SLURM for something would wait for a controller that is not there.
    rm -f /etc/slurm/slurm.conf
    exit
fi
cpus=${1:-2} memory=${2:-4000} host=$(hostname -s)
stop
mkdir -p /etc/slurm /var/spool/slurmctld /var/spool/slurmd /run/munge /var/log/munge
chown -R munge: /run/munge /var/log/munge /etc/munge
# Programs look for it here, whatever SLURM_CONF says.
cat > /etc/slurm/slurm.conf <<CONF
ClusterName=one
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
AuthType=auth/munge
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
ReturnToService=2
SlurmdTimeout=15
JobRequeue=1
MinJobAge=300
StateSaveLocation=/var/spool/slurmctld
SlurmdSpoolDir=/var/spool/slurmd
SlurmctldLogFile=/var/log/slurmctld.log
SlurmdLogFile=/var/log/slurmd.log
NodeName=$host NodeAddr=127.0.0.1 CPUs=$cpus RealMemory=$memory State=UNKNOWN
PartitionName=one Nodes=ALL Default=YES MaxTime=INFINITE State=UP
CONF
[ -s /etc/munge/munge.key ] || mungekey --create --force
chown munge: /etc/munge/munge.key
runuser -u munge -- munged
slurmctld
slurmd -N "$host"
for _ in $(seq 30); do
    if sinfo --noheader --format %t 2>/dev/null | grep -q idle; then
        sinfo
        exit
    fi
    sleep 1
done
echo "no node came up: see /var/log/slurmctld.log and /var/log/slurmd.log" >&2
exit 1
