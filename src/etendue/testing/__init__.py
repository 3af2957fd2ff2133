"""The conformance kit: every stage, ours or a stranger's, is held against its own declaration.

A plugin's test file is all of this (``tests/test_conformance.py``)::

    from etendue.testing import StageConformance
    from my_plugin.stages import MyStage

    class TestMyStage(StageConformance):
        stage = MyStage(iterations=5)

    class TestMyStageInTheDark(StageConformance):
        stage = MyStage(iterations=0)        # parameters for which `negligible` says more
        scales = {"charge": 10.0}            # full scale of a port, where the usual one is not the one that matters

From the declaration alone the kit makes grids, arrays, coordinates and random generators, and computes cells with the
engine's own ``run.cell.compute``, so that the two cannot disagree. Each test method is one law; a broken law names
the stage, the values and what to change. ``check_stage`` runs all laws of one instance without pytest and gives
``Finding`` values. A source is checked on the grid it describes: give it a small one. ``grids`` replaces the grid of
a port whose dims the kit cannot guess, ``coordinates`` the entries of one dim in frames of any size. ``coordinates_of``
gives the coordinates of grids as ``prepare`` and ``run`` get them.

In:  an instance of a stage.
Out: nothing, or what it declares and does not do.
"""

from etendue.contract.arrays.coordinates import coordinates_of
from etendue.testing.bench import Finding, LawBroken
from etendue.testing.conformance import StageConformance, check_stage, laws

__all__ = ["Finding", "LawBroken", "StageConformance", "check_stage", "coordinates_of", "laws"]
