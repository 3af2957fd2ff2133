"""Real cameras and lenses by name: readers of published measurements, and stand-ins for values that nobody has
published.

Heavy imports are late, because a name is looked up each time a pipeline is read.
"""
