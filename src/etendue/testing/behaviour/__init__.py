"""What a stage does with places, ranges, codes, noise and state; ``laws`` has a test method for each."""
