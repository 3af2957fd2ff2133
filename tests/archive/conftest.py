"""A finished archive of the smallest camera, once for each file of tests; its larger cells are stored in row bands."""

import pytest

from etendue.archive.structure import cutting
from etendue.session import Options, execute
from tests.archive.tiny import LARGEST, SMALL, tiny_plan


@pytest.fixture(scope="module", autouse=True)
def in_bands(request):
    """Cells above a few kB are large: those of the light are cut in bands, of the pixels not. Files that start other
    processes say so.
    """
    with pytest.MonkeyPatch.context() as patch:
        if not getattr(request.module, "WHOLE_CELLS", False):
            patch.setattr(cutting, "LARGEST_CHUNK", LARGEST)
            patch.setattr(cutting, "SMALL", SMALL)
        yield


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("tiny")


@pytest.fixture(scope="module")
def plan(place):
    return tiny_plan(place)


@pytest.fixture(scope="module")
def whole(place, plan):
    execute(plan, place / "whole", Options("serial"))
    return place / "whole"
