"""Sensor stages up to charge: photodiode, silicon, colour filters, crosstalk, defects.

In:  ``irradiance``.
Out: ``photon_rate`` by channel or as a mosaic, and maps of defective pixels.
"""
