"""What stands on a terminal: the plan, progress, tables."""
