"""Connection of stages to a graph: parameters, shared quantities, axes, ports."""
