"""The laws of the conformance kit, by subject."""
