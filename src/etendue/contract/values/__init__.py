"""Numbers of a request: units, parameters, shared quantities, names, limits."""
