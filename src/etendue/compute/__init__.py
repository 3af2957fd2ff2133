"""All code that can affect the bits of a cell's result; its digest is part of the key of every cell.

In:  jobs.
Out: arrays.
"""
