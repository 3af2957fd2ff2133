"""Own spectral cubes in: files of other programs become the Zarr store that the stage ``radiance_cube`` reads.

cube     what a file holds, whatever its format, and what a person says of it
arrays   .npy, .npz, .mat (ISETCam's too), HDF5
rasters  ENVI, spectral OpenEXR, TIFF of several pages
store    the Zarr store
"""
