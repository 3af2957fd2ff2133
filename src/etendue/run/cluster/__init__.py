"""Batches on dask.distributed: a cluster that is there already, or one of this machine for the length of a run.

``connect``  who computes, and what is said when nobody does
``own``      a cluster of this machine: processes on loopback, talking TLS
``alike``    what everybody who computes must have in common with the owner of the run
``sending``  batches as they become ready, few per thread, so that nobody holds the whole graph
``suspects`` batches of which workers died: their cells one by one, alone on the cluster
``watching`` whether the scheduler is still there
``tasks``    what a worker is asked to do
"""
