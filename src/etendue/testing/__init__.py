"""The conformance kit: tests every stage, built-in or from a plugin, against its own declaration.

The whole test file of a plugin (``tests/test_conformance.py``)::

    from etendue.testing import StageConformance
    from my_plugin.stages import MyStage

    class TestMyStage(StageConformance):
        stage = MyStage(iterations=5)

    class TestMyStageInTheDark(StageConformance):
        stage = MyStage(iterations=0)        # parameters for which `negligible` states more
        scales = {"charge": 10.0}            # full scale of a port, if the usual one is not the relevant one

From the declaration alone the kit makes grids, arrays, coordinates and random generators, and computes cells with the
engine's own ``compute.cell.compute``: a stage is tested by the code that runs it. Each test method is one law; a broken
law names the stage, the values and a remedy. ``check_stage`` runs all laws of one instance without pytest and returns
``Finding`` values. A source is tested on the grid that it describes, which should be small. ``grids`` sets the grid of
a port whose dims the kit cannot guess; ``coordinates`` sets the entries of one dim, for frames of any size.
``coordinates_of`` returns the coordinates of grids as ``prepare`` and ``run`` get them.

In:  an instance of a stage.
Out: nothing, or a description of each law that the stage breaks.
"""

from etendue.contract.arrays.coordinates import coordinates_of
from etendue.testing.bench import Finding, LawBroken
from etendue.testing.conformance import StageConformance, check_stage, laws

__all__ = ["Finding", "LawBroken", "StageConformance", "check_stage", "coordinates_of", "laws"]
