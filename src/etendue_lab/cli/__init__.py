"""Commands that studies bring."""
