"""What light is before it meets glass: spectra, radiometry, and the grids it is sampled on.

In:  spectra, temperatures, shapes.
Out: radiance and irradiance factors, means over cells, transforms and their padding.
"""
