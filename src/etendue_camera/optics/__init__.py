"""The lens: light gathering and image of a point, uniform over the frame.

In:  f-number, wavelength, distances, Zernike coefficients, frequency.
Out: optical transfer functions, point spread functions, cones and factors.
"""
