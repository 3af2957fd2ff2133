"""The lens: how much light it gathers and where a point goes, the same all over the frame.

In:  f-number, wavelength, distances, Zernike coefficients, frequency.
Out: optical transfer functions, point spread functions, cones and factors.
"""
