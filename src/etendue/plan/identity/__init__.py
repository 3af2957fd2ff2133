"""The code and values on which a result depends: digests of modules, and keys."""
