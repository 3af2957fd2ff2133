"""From charge to digital numbers: exposure, noise, amplifier, ADC, and metrics of both.

In:  electron rates, times, gains, random generators.
Out: charge, codes, linear signal; dynamic range, speed, photon transfer.
"""
