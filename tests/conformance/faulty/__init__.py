"""Stages that are wrong within their declared ranges by more than ten times what they state, grouped by kind of fault.

Each looks right in its declaration. ``FAULTY``: by kind, the classes; every kind has at least three.
"""

from tests.conformance.faulty import geometry, noise, ranges, several, state, values

FAULTY = {**geometry.FAULTY, **noise.FAULTY, **ranges.FAULTY, **several.FAULTY, **state.FAULTY, **values.FAULTY}
