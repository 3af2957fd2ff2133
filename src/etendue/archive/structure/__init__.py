"""Groups, arrays, dims and names of the Zarr tree, and the metadata written for them."""
