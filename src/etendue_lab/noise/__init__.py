"""Noise after every stage of a camera, predicted and measured."""
