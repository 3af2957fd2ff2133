"""Error against run time: errors measured against the reference, settings that hold a tolerance."""
