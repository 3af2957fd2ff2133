#!/bin/sh
# A local Dask cluster that stays up for many runs: a scheduler and WORKERS processes on loopback.
#
#     sh docs/cluster/local.sh etendue run pipelines/smallest.toml
#
# runs the command with --scheduler added, and ends the cluster afterwards. For one run, `--scheduler distributed` is shorter.
set -eu
port=${PORT:-8786}
dask scheduler --host 127.0.0.1 --port "$port" --no-dashboard >scheduler.log 2>&1 &
scheduler=$!
dask worker "tcp://127.0.0.1:$port" --host 127.0.0.1 --nworkers "${WORKERS:-2}" --nthreads 1 --no-dashboard >workers.log 2>&1 &
workers=$!
trap 'kill $workers $scheduler 2>/dev/null; wait' EXIT
"$@" --scheduler "tcp://127.0.0.1:$port"
