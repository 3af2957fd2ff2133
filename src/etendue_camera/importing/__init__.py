"""Own spectral cubes in: files of other programs become the Zarr store that the stage ``radiance_cube`` reads.

cube     what a file holds, whatever its format, and what a person says of it
formats  endings of files and their readers
arrays   readers of files of arrays
rasters  readers of files of pictures
store    the Zarr store
"""
