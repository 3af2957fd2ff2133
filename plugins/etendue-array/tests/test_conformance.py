"""The stages keep what they declare."""

import pytest
from etendue_array.beam import BeamFigures, DelayAndSum
from etendue_array.hearing import PARTS, MicrophoneNoise, Phasors
from etendue_array.sound import PlaneWave, SecondWave

from etendue.api import Grid, Line
from etendue.testing import StageConformance

MICROPHONES = Line(6, -0.2, 0.08, "m")
HEARD = {"pressure": Grid.of({"microphone": MICROPHONES, "time": Line(64, 0.0, 1 / 16000, "s")})}
FREQUENCIES = Line(9, 500.0, 250.0, "Hz")


class TestPlaneWave(StageConformance):
    stage = PlaneWave(samples=64)


class TestSecondWave(StageConformance):
    stage = SecondWave(other_rms=0.3)
    grids = HEARD


class TestMicrophoneNoise(StageConformance):
    stage = MicrophoneNoise()
    grids = HEARD


class TestPhasors(StageConformance):
    stage = Phasors()
    grids = HEARD


@pytest.mark.parametrize("taper", ["uniform", "hann"])
class TestDelayAndSum(StageConformance):
    grids = {"phasor": Grid.of({"part": PARTS, "frequency": FREQUENCIES, "microphone": MICROPHONES})}

    @pytest.fixture(autouse=True)
    def _each_taper(self, taper):
        self.stage = DelayAndSum(taper=taper, directions=37)


class TestBeamFigures(StageConformance):
    stage = BeamFigures()
    grids = {"beam": Grid.of({"frequency": FREQUENCIES, "direction": Line(37, -90.0, 5.0, "deg")})}
