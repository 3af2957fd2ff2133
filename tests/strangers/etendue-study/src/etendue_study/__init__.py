"""A study by somebody else: which figure moves most when one quantity moves."""
