"""From charge to digital numbers: exposure, noise, amplifier, ADC, and the metrics of both.

In:  ``photon_rate`` of a mosaic.
Out: ``charge``, ``dn`` and ``mosaic_linear``; metrics of exposure and noise.
"""
