"""Execution: cells as jobs, grouped into batches that run one after the other, in threads, processes or on a cluster.

In:  a plan, the cells to compute, the storage backend.
Out: a report of every cell; its arrays to the backend.
"""
