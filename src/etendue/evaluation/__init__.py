"""Evaluations of one pipeline at many values: what was computed and planned before is read from memory."""
