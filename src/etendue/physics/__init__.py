"""Kernels: plain functions on arrays, in wings that follow the light.

scene -> light -> optics -> field -> sensor -> electronics -> mosaic -> restoration -> colour -> resolution -> quality.
A wing imports wings in front of it, never one behind. No labels, no files, no Dask.
"""
