"""From charge to numbers: exposure, noise, amplifier, converter, and what they make possible.

In:  electron rates, times, gains, random generators.
Out: charge, codes, linear signal; dynamic range, speed, photon transfer.
"""
