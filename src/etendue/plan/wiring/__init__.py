"""Stages wired to a graph: parameters, shared quantities, axes, ports."""
