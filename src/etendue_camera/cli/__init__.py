"""Commands that a camera brings: sensors, raw exports, spectral cubes."""
