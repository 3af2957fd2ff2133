"""Measurement of a sensor according to EMVA 1288."""
