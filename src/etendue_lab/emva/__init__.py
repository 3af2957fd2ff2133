"""A sensor measured after EMVA 1288."""
