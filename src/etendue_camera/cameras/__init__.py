"""Cameras and lenses that exist, by name: readers of what others have measured, and what they do not say.

Heavy imports are late: a name is looked up when a pipeline is read.
"""
