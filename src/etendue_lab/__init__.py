"""Studies of cameras: ranking of alternatives, quality, information, losses, noise, measurement of sensors and
photographs.
"""
