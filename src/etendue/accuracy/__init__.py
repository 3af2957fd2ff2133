"""Error against run time: errors measured against the reference, and settings that keep within a tolerance."""
