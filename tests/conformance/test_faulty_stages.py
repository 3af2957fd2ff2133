"""Faulty stages are caught by the laws that the kit and the command share; the sound stages beside them are not."""

import numpy as np
import pytest

from etendue_lab.stability.stages import rows_of_kind
from tests.conformance.faulty import FAULTY, sound, state

EVERY = [(kind, one) for kind, several in FAULTY.items() for one in several]


@pytest.fixture(autouse=True)
def _fresh():
    state.forget()


def test_there_are_forty_of_at_least_twelve_kinds():
    assert len(EVERY) >= 40
    assert len(FAULTY) >= 12
    assert min(map(len, FAULTY.values())) >= 3
    assert len({one for _, one in EVERY}) == len(EVERY)


@pytest.mark.long
@pytest.mark.parametrize(("kind", "one"), EVERY, ids=[one.__name__ for _, one in EVERY])
def test_a_faulty_stage_is_caught(kind, one):
    rows = rows_of_kind(one.__name__, one)
    assert next((row for row in rows if row.ok is False), None), kind


@pytest.mark.long
@pytest.mark.parametrize("one", sound.SOUND, ids=lambda one: one.__name__)
def test_a_sound_stage_is_not_accused(one):
    assert [row for row in rows_of_kind(one.__name__, one) if row.ok is False] == []


def test_sound_stages_do_something():
    assert len(sound.SOUND) >= 8
    assert np.all([one.run is not None for one in sound.SOUND])
