"""Transfer functions: products, sampled planes, and how much they change the light of a source."""
