"""What code and values a result depends on: digests of modules and keys."""
