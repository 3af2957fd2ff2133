"""A camera against the ideal camera of the same scene."""
