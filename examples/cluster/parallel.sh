#!/usr/bin/env bash
# Runs an Antumbra command in N shards with GNU parallel, then merges them:
#
#   ./parallel.sh N NAME.shards COMMAND...
#   PARALLEL="--sshloginfile nodes --workdir $PWD" ./parallel.sh 8 town.shards render town.glb --preset final -o town.png
#
# GNU parallel reads options from PARALLEL, such as a list of hosts, which must share this folder. A shard uses all
# cores of its host, so each host runs one shard at a time. Without GNU parallel, xargs runs the shards on this machine.
set -euo pipefail

if [ $# -lt 3 ]; then
    echo "usage: $0 N NAME.shards COMMAND..." >&2
    exit 2
fi
n=$1 shards=$2
shift 2

if command -v parallel >/dev/null; then
    seq 0 $((n - 1)) | parallel --quote --jobs 1 --retries 3 --halt now,fail=1 antumbra "$@" --shard "{}/$n"
else
    seq 0 $((n - 1)) | xargs -I{} antumbra "$@" --shard "{}/$n"
fi
antumbra merge "$shards"
