"""The stage keeps what it declares."""

import pytest
from etendue_demosaic_menon.stages import DemosaicMenon

from etendue.testing import StageConformance


@pytest.mark.parametrize(("pattern", "refine"), [("RGGB", True), ("BGGR", True), ("GRBG", False), ("GBRG", True)])
class TestDemosaicMenon(StageConformance):
    @pytest.fixture(autouse=True)
    def _each(self, pattern, refine):
        self.stage = DemosaicMenon(pattern=pattern, refine=refine)
