"""A graph expanded to cells: grids, facts, omissions, keys and seeds."""
