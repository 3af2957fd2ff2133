"""A sensor file from real frames, and its check against them."""
