"""Picture quality: against a reference, and to an observer.

In:  full planes of the sensor.
Out: the reference that a perfect reconstruction would give.
"""
