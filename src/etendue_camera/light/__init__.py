"""Light before the lens: spectra, radiometry, and sampling grids.

In:  spectra, temperatures, shapes.
Out: radiance and irradiance factors, means over cells, transforms and their padding.
"""
