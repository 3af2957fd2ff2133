"""Camera commands: sensors, raw exports, spectral cubes."""
