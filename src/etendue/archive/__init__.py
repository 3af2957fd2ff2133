"""Storage of results: one Zarr store with its journal, run records and copies of input files, or the same tree in
memory.

In:  a plan, the reports and arrays of cells (``keeper``, ``memory``).
Out: the cells that remain to be computed; a store that xarray opens without etendue.
"""
