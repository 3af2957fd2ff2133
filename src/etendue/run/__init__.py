"""How it is computed: cells as jobs, batches of them, one after the other, in threads, in processes or on a cluster.

In:  a plan, the cells to compute, where results are kept.
Out: a report of every cell; its arrays to whoever keeps them.
"""
