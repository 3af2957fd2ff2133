"""A finished archive of the smallest camera, once for each file of tests."""

import pytest

from etendue.session import Options, execute
from tests.archive.tiny import tiny_plan


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
