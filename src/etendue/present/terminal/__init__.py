"""Terminal output: plans, progress, tables."""
