#!/usr/bin/env bash
# Runs an Antumbra command as a SLURM array of N jobs, and a job that merges their shards:
#
#   ./slurm.sh N NAME.shards COMMAND...
#   ./slurm.sh 64 city.shards sun city.json --days year:2026 -o city.csv
#
# The folder must be on storage shared by all nodes. SBATCH_* variables set partitions, limits and cores, such as
# SBATCH_PARTITION=cpu or SBATCH_TIMELIMIT=2:00:00. A requeued job resumes where it stopped.
set -euo pipefail

if [ $# -lt 3 ]; then
    echo "usage: $0 N NAME.shards COMMAND..." >&2
    exit 2
fi
n=$1 shards=$2
shift 2

if [ -n "${SLURM_ARRAY_TASK_ID:-}" ]; then
    exec antumbra "$@" --shard "auto/$n" --threads "${SLURM_CPUS_ON_NODE:-$(nproc)}"
fi
antumbra warmup --quiet # so that jobs do not compile the same kernels
array=$(sbatch --parsable --array="0-$((n - 1))" --requeue "$0" "$n" "$shards" "$@")
sbatch --parsable --dependency="afterok:$array" --wrap="antumbra merge $(printf %q "$shards")"
