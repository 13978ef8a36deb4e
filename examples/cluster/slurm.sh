#!/usr/bin/env bash
# A command of Antumbra as a SLURM array of N jobs, and one job that merges their shards:
#
#   ./slurm.sh N NAME.shards COMMAND...
#   ./slurm.sh 64 city.shards sun city.json --days year:2026 -o city.csv
#
# The folder must be on storage that all nodes share. SBATCH_* variables set partitions, limits and cores, such as
# SBATCH_PARTITION=cpu or SBATCH_TIMELIMIT=2:00:00. A job that is repeated goes on where the first one stopped.
set -euo pipefail

if [ $# -lt 3 ]; then
    echo "usage: $0 N NAME.shards COMMAND..." >&2
    exit 2
fi
n=$1 shards=$2
shift 2

if [ -n "${SLURM_ARRAY_TASK_ID:-}" ]; then
    exec antumbra "$@" --shard "$SLURM_ARRAY_TASK_ID/$n" --threads "${SLURM_CPUS_ON_NODE:-$(nproc)}"
fi
antumbra warmup --quiet # so that no job compiles what another one compiles
array=$(sbatch --parsable --array="0-$((n - 1))" --requeue "$0" "$n" "$shards" "$@")
sbatch --parsable --dependency="afterok:$array" --wrap="antumbra merge $(printf %q "$shards")"
