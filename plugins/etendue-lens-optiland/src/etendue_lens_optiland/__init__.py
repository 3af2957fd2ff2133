"""Ray-traced lenses for etendue: prescriptions, rays traced by optiland, and their effect on light."""
