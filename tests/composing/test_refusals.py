"""What Python calls refuse: in words of arguments, with a traceback of the call alone."""

from __future__ import annotations

import traceback

import pytest

import etendue
from etendue import stages as s
from etendue.calls import in_arguments
from etendue.errors import ArchiveError, EtendueError, PluginError, RequestError
from etendue_camera.models import Irradiance
from tests.run.small import BARE

LIGHT = {"white_luminance": "100 cd m-2", "width": "80 um", "height": "80 um"}


@pytest.fixture(scope="module")
def pipeline():
    return etendue.Pipeline(s.uniform(**LIGHT), s.irradiance(), name="grey").camera(f_number=4)


@pytest.fixture(scope="module")
def tree():
    return etendue.simulate(BARE, want=["rgb_camera", "mtf"])


REFUSED = {
    "a camera quantity": (lambda p, t: p.camera(f_numbr=3).plan(), "camera.f_numbr: unknown camera quantity"),
    "an axis": (lambda p, t: p.sweep(f_numbr=[2, 3]).run(), "cannot sweep 'f_numbr': unknown name"),
    "a stage itself": (
        lambda p, t: p.swap("irradiance", Irradiance()),
        "stage 2: expected a placed stage, got Irradiance(",
    ),
    "one variable": (lambda p, t: etendue.simulate(p, want="foo"), "no stage of this pipeline writes 'foo'"),
    "one variable to run": (lambda p, t: p.run(want="foo"), "no stage of this pipeline writes 'foo'"),
    "a parameter of a stage": (lambda p, t: s.uniform(lumen=3), "uniform.lumen: unknown parameter"),
    "a scheduler": (lambda p, t: p.run(scheduler="thread"), "scheduler='thread': unknown scheduler"),
    "an axis to compare": (lambda p, t: p.compare("irradiance"), "axis='irradiance': irradiance is a stage"),
    "a stage to leave out": (lambda p, t: p.quality(without=["foo"]), "without='foo': unknown stage"),
    "a call of simulate": (lambda p, t: etendue.simulate(p, f_numbr=3), "camera.f_numbr"),
    "an archive": (lambda p, t: etendue.Archive("nowhere"), "is not an archive"),
    "a plot": (lambda p, t: t.etendue.plot.map("foo"), "unknown variable 'foo'"),
    "lines": (lambda p, t: t.etendue.plot.curves("mtf", lines="foo"), "lines='foo': not a dim"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_refused_call_is_told_in_its_own_words_and_where_it_stands(what, pipeline, tree):
    call, said = REFUSED[what]
    with pytest.raises(EtendueError) as refused:
        call(pipeline, tree)
    assert said in str(refused.value)
    assert "--" not in str(refused.value)
    ours = [frame.name for frame in traceback.extract_tb(refused.value.__traceback__) if frame.filename != __file__]
    assert ours == ["call"]
    assert refused.value.__suppress_context__ and refused.value.__cause__ is None


def test_a_fault_of_a_plugin_keeps_all_of_its_traceback():
    from etendue.calls import called

    def broken():
        raise PluginError("inner")

    def outer():
        return broken()

    with pytest.raises(PluginError) as found:
        called(outer)()
    assert [frame.name for frame in traceback.extract_tb(found.value.__traceback__)][-2:] == ["outer", "broken"]


@pytest.mark.parametrize(
    ("option", "argument"),
    [
        ("--scheduler thread: there is no such scheduler", "scheduler='thread': there is no such scheduler"),
        ("--reflectance 2: expected a number", "reflectance=2: expected a number"),
        ("--at f_number=4: that was not computed", "f_number=4: that was not computed"),
        ("choose with --at stage=pixel (or lens)", "choose with stage=pixel (or lens)"),
        ("look at --encoding and --space", "look at encoding= and space="),
        ("mend it: etendue verify ARCHIVE --repair", "mend it: etendue verify ARCHIVE --repair"),
        ("both: --archive b --want x.y --want z", "both: archive='b' want=['x.y', 'z']"),
        ("remove them with --prune", "remove them with etendue run --prune"),
        (
            "write over it with --force, or elsewhere with --output",
            "write over it with force=True, or elsewhere with output=",
        ),
    ],
)
def test_options_become_arguments_and_commands_stay(option, argument):
    assert in_arguments(option) == argument


def test_the_command_line_speaks_of_options_still():
    from etendue.run.schedulers import check_scheduler

    with pytest.raises(RequestError, match=r"^--scheduler thread"):
        check_scheduler("thread")
    with pytest.raises(ArchiveError):
        etendue.open_archive("nowhere")
