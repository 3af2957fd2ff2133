"""A line of microphones: from waves of sound to the direction that they come from."""
