"""Each stage's share of the lost contrast, signal-to-noise ratio and colour."""
