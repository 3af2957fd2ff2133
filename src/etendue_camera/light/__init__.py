"""Light before the lens: black-body spectra and radiometry.

In:  wavelengths, temperatures; f-numbers, magnifications, field angles.
Out: black-body radiance; irradiance factors, photon numbers, fields of view.
"""
