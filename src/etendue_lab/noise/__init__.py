"""Noise behind every stage of a camera, predicted and found."""
