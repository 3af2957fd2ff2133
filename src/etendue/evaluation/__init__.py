"""Evaluations of one pipeline at many values: results and plans of earlier evaluations are read from memory."""
