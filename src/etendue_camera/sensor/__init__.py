"""The sensor up to charge: photodiode, silicon, colour filters, crosstalk, defects.

In:  irradiance, geometry in um, tables of sensitivity, masks.
Out: transfer functions, photon and electron rates, mosaics.
"""
