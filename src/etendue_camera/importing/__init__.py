"""Import of spectral cubes: files of other programs become the Zarr store that the stage ``radiance_cube`` reads.

cube     the content of a file, whatever its format, and what the user states about it
formats  file extensions and their readers
arrays   readers of array files
rasters  readers of picture files
store    the Zarr store
"""
