"""Names of types for annotations; nothing is computed here."""
