"""Search for the settings of a camera that make a metric best, within limits."""
