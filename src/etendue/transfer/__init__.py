"""Transfer functions: their products, sampled planes, and what they change of what a source holds."""
