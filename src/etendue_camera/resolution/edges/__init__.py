"""The slanted edge: search for it, its edge spread function, and confidence intervals of its resolution."""
