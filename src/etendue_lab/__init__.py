"""Questions about cameras: alternatives ranked, quality, information, losses, noise, measured sensors and
photographs.
"""
