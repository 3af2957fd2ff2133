"""Batches on dask.distributed: an existing cluster, or one on this machine for the length of a run.

``connect``  connects to the cluster, and reports when it does not answer
``own``      a cluster on this machine: processes on loopback, with TLS
``alike``    what all workers must have in common with the owner of the run
``sending``  sends batches as they become ready, few per thread, so that nobody holds the whole graph
``suspects`` retries batches whose workers died, cell by cell, alone on the cluster
``watching`` watches whether scheduler and workers are still there
``tasks``    what a worker is asked to do
"""
