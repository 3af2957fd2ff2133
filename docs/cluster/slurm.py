"""Start workers as SLURM jobs for the duration of a run.

    python slurm.py --jobs 4 run paper.toml --archive /shared/paper

requests 4 jobs, waits for the first, runs ``etendue run paper.toml --archive /shared/paper --scheduler tcp://...`` and
ends the jobs afterwards. Start it where jobs can reach this machine (a login node, or a separate job). The archive,
the pipeline's input files and the Python environment must be at the same paths on every node. If SLURM ends a job, its
cells are computed by another worker.

    pip install 'etendue[distributed]' dask-jobqueue
"""

import argparse
import subprocess
import sys

from dask_jobqueue import SLURMCluster

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--cores", type=int, default=2, help="worker processes per job, with one thread each")
    parser.add_argument("--memory", default="4GB", help="memory per job")
    parser.add_argument("--time", default="01:00:00")
    parser.add_argument("--partition")
    parser.add_argument("--interface", help="network interface between nodes, such as ib0")
    parser.add_argument("--host", help="address at which jobs reach this machine; default: that of the interface")
    given, words = parser.parse_known_args()

    options = {"dashboard": False} | ({"host": given.host} if given.host else {})
    with SLURMCluster(
        cores=given.cores,
        processes=given.cores,
        memory=given.memory,
        walltime=given.time,
        queue=given.partition,
        interface=given.interface,
        scheduler_options=options,
        local_directory="/tmp",
        log_directory="slurm-logs",
    ) as cluster:
        cluster.scale(jobs=given.jobs)
        cluster.wait_for_workers(1, timeout=3600)
        command = [sys.executable, "-m", "etendue", *words, "--scheduler", cluster.scheduler_address]
        code = subprocess.run(command, check=False).returncode
    sys.exit(code)
