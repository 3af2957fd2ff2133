"""The stages keep what they declare; those of a library that is not installed are passed over."""

import pytest

from etendue.testing import StageConformance


def of(library, module, name, **values):
    pytest.importorskip(library, reason=f"{library} is not installed: pip install plugins/etendue-other-libraries")
    return getattr(pytest.importorskip(f"etendue_other_libraries.{module}"), name)(**values)


@pytest.mark.parametrize(
    ("library", "module", "name", "values"),
    [
        pytest.param("cv2", "from_opencv", "Bilinear", {"pattern": "RGGB"}, id="bilinear"),
        pytest.param("cv2", "from_opencv", "EdgeAware", {"pattern": "GBRG"}, id="edge_aware"),
        pytest.param("cv2", "from_opencv", "GradientNumber", {"pattern": "BGGR"}, id="vng"),
        pytest.param("skimage", "from_skimage", "NonLocalMeans", {}, id="nl_means"),
        pytest.param("skimage", "from_skimage", "RichardsonLucy", {"iterations": 4}, id="richardson_lucy"),
        pytest.param("scipy", "from_scipy", "LocalWiener", {}, id="wiener"),
    ],
)
class TestOtherLibraries(StageConformance):
    @pytest.fixture(autouse=True)
    def _each(self, library, module, name, values):
        self.stage = of(library, module, name, **values)
