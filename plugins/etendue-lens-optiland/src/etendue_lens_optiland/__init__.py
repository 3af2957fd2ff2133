"""Ray-traced lenses for etendue: a prescription, its rays by optiland, and what they make of the light."""
