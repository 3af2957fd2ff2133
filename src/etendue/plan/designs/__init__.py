"""Designs: lists of samples over several parameters, drawn from distributions."""
