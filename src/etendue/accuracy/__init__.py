"""Error against run time: errors relative to the reference, and settings that keep errors within a tolerance."""
