"""Workers as jobs of SLURM, for the length of a run.

    python slurm.py --jobs 4 run paper.toml --archive /shared/paper

asks for 4 jobs, waits for the first, runs ``etendue run paper.toml --archive /shared/paper --scheduler tcp://...`` and
ends the jobs behind it. Start it where jobs can reach this machine (a login node, or a job of its own). The archive,
the pipeline's input files and the Python environment stand at the same paths on every node. A job that SLURM ends takes
no cell with it: another worker computes it.

    pip install 'etendue[distributed]' dask-jobqueue
"""

import argparse
import subprocess
import sys

from dask_jobqueue import SLURMCluster

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--cores", type=int, default=2, help="worker processes of a job, of one thread each")
    parser.add_argument("--memory", default="4GB", help="of a job")
    parser.add_argument("--time", default="01:00:00")
    parser.add_argument("--partition")
    parser.add_argument("--interface", help="the network over which nodes talk, such as ib0")
    parser.add_argument("--host", help="the address at which jobs reach this machine; default: that of the interface")
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
