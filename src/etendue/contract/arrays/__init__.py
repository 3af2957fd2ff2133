"""Descriptions of arrays before they exist: dims, grids, variables, facts, how they are drawn."""
