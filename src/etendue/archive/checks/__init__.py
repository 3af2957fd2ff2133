"""Archives described, verified and rebuilt."""
