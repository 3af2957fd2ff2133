"""Where results are kept: one Zarr store with its journal, records and copies of input files; or the same tree in
memory.

In:  a plan, reports and arrays of cells (``keeper``, ``memory``).
Out: what is left to compute; a store that xarray opens without etendue.
"""
