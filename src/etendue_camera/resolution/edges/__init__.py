"""The slanted edge: finding it, its spread function, and the interval of what is measured."""
