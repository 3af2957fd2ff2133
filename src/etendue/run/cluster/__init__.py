"""Batches on dask.distributed: an existing cluster, or one on this machine for the length of a run.

``connect``   connects to the cluster, and reports when it does not answer
``own``       starts a cluster on this machine: processes on loopback, with TLS
``alike``     compares libraries, processor, code and archive of a worker with those of the owner of the run
``sending``   sends batches as they become ready, few per thread, so that no process holds the whole graph
``suspects``  retries batches whose workers died, cell by cell, alone on the cluster
``watching``  checks that scheduler and workers still respond
``tasks``     holds the functions that a worker runs
"""
