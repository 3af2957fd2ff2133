"""The stage keeps what it declares."""

import pytest
from etendue_demosaic_malvar.stages import DemosaicMalvar

from etendue.testing import StageConformance


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
class TestDemosaicMalvar(StageConformance):
    @pytest.fixture(autouse=True)
    def _each_pattern(self, pattern):
        self.stage = DemosaicMalvar(pattern=pattern)
