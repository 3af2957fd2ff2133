"""Transfer functions: products, sampled planes, and bounds on how much they change the light of a source."""
