"""Transfer functions: products, sampled planes, and bounds on their effect on the light of a source."""
