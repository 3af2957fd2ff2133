"""The stages keep what they declare."""

import pytest

pytest.importorskip("optiland")

from etendue_lens_optiland.stages import Blur, Distortion, Illumination, Numbers

from etendue.testing import StageConformance

# a slow stop and few samples: the laws are about the stage, not about the lens; of the reference wavelength the lateral
# colour is exactly 0, which has no scale to hold a change against, so that numbers has another
BLUR = {"f_number": 8.0, "fields": (0.0, 22.0), "pupil_samples": 32, "lost": 0.2, "wavelengths": (500.0, 600.0)}


@pytest.mark.parametrize(
    "stage",
    [
        pytest.param(Blur(**BLUR), id="blur"),
        pytest.param(Blur(**BLUR | {"weights": "image", "fields": (0.0,), "window": 12.0}), id="blur-one-field"),
        pytest.param(Distortion(f_number=8.0, nodes=6), id="distortion"),
        pytest.param(Distortion(f_number=8.0, nodes=4, order=1, focal_length=0.5), id="distortion-short"),
        pytest.param(
            Illumination(f_number=8.0, nodes=4, pupil_samples=16, focal_length=0.5, wavelengths=(500.0, 600.0)),
            id="illumination",
        ),
        pytest.param(Numbers(f_number=8.0, pupil_samples=16, fields=(0.0, 22.0), wavelengths=(500.0,)), id="numbers"),
    ],
)
class TestRealLens(StageConformance):
    @pytest.fixture(autouse=True)
    def _each_stage(self, stage):
        self.stage = stage
