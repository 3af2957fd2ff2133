"""Everything that can change a bit of a cell: its digest is in the key of every cell.

In:  jobs.
Out: arrays.
"""
