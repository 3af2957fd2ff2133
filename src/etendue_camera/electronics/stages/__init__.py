"""From charge to numbers: exposure, noise, amplifier, converter, and what they make possible.

In:  ``photon_rate`` of a mosaic.
Out: ``charge``, ``dn`` and ``mosaic_linear``; figures of exposure and noise.
"""
