"""A camera compared with the ideal camera of the same scene."""
