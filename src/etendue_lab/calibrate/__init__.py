"""Calibration of a sensor: a sensor file from real frames, and a comparison of the calibrated sensor with these
frames.
"""
