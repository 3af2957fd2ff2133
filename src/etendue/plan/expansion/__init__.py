"""A graph expanded to cells: grids, facts, what is left out, keys and seeds."""
