"""The sensor up to charge: photodiode, silicon, colour filters, crosstalk, defects.

In:  ``irradiance``.
Out: ``photon_rate`` by channel or as a mosaic, and what is known of single pixels.
"""
