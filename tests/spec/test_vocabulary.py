"""What several distributions bring under one name, or wrongly, is a fault of the pipeline that uses it; of no other."""

from types import ModuleType

import pytest

import etendue
from etendue.contract.arrays import variables
from etendue.contract.registry import Registry
from etendue.contract.values import quantities as camera
from etendue.contract.values import tables
from etendue.errors import PluginError, RequestError
from etendue.pipeline import presets
from etendue.pipeline.file import from_document
from etendue.plan.identity.keys import parameters_for_key
from etendue.plan.planner import make_plan
from etendue.plugins import discovery
from etendue.plugins.discovery import Discovery
from etendue.plugins.hookspecs import hookimpl
from etendue_camera import spectra
from tests.distributions import distribution as made_up


class Point:
    """The entry point of a distribution that brings one thing of one kind."""

    def __init__(self, distribution, what, value):
        self.name, self.value = distribution, distribution.replace("-", "_")
        self.dist = made_up(distribution)
        self.manifest = ModuleType(self.value)
        setattr(self.manifest, f"etendue_{what}", hookimpl(lambda: value))

    def load(self):
        return self.manifest


@pytest.fixture
def bring(monkeypatch):
    """What is installed, and these beside it: (distribution, kind, mapping)."""
    before = discovery.installed()

    def also(*brought):
        found = Discovery([*before.points, *(Point(*one) for one in brought)])
        monkeypatch.setattr(discovery, "installed", lambda: found)
        forget()
        return Registry(found)

    def forget():
        for known in (camera.declared, variables.variable, presets.preset):
            known.cache_clear()

    yield also
    monkeypatch.undo()
    forget()


def faults(registry, *stages, **tables):
    with pytest.raises(RequestError) as caught:
        make_plan(from_document({"stages": [{"use": use} for use in stages], **tables}), registry)
    return str(caught.value)


PIXEL = "pixel_numbers"  # writes full_well, takes the camera's pixel_pitch and alone reads nothing
OTHER = "lens_numbers"


def test_two_distributions_that_bring_one_quantity_are_a_fault_of_what_takes_it(bring):
    registry = bring(("theirs", "quantities", {"pixel_pitch": {"default": 5.4, "units": "um"}}))
    said = faults(registry, PIXEL)
    assert "camera.pixel_pitch" in said and f"{PIXEL} takes it" in said and "provided by etendue and theirs" in said
    make_plan(from_document({"stages": [{"use": OTHER}]}), registry)


def test_a_variable_is_a_fault_only_where_two_distributions_disagree(bring):
    own = discovery.installed().first("variables", "full_well").value
    make_plan(from_document({"stages": [{"use": PIXEL}]}), bring(("theirs", "variables", {"full_well": dict(own)})))
    registry = bring(("theirs", "variables", {"full_well": {**own, "units": "kg"}}))
    assert "etendue and theirs define its variable 'full_well' differently" in faults(registry, PIXEL)
    make_plan(from_document({"stages": [{"use": OTHER}]}), registry)


def test_two_distributions_that_bring_one_sensor_are_a_fault_of_what_names_it(bring):
    registry = bring(("theirs", "sensors", {"sony-imx174": {}}))
    assert "provided by etendue and theirs" in faults(registry, PIXEL, camera={"sensor": "sony-imx174"})
    make_plan(from_document({"camera": {"sensor": "sony-imx250"}, "stages": [{"use": PIXEL}]}), registry)


@pytest.mark.parametrize("name", ["D65", "Nikon 5100 (NPL)", "flat"])
def test_a_spectrum_in_the_place_of_one_of_the_library_is_refused(bring, name, tmp_path):
    bring(("theirs", "spectra", {name: tmp_path / "a.csv"}))
    with pytest.raises(ValueError, match="provided by etendue and theirs"):
        spectra.spectrum(name)
    assert spectra.spectrum("D50") == ""


def test_a_spectrum_without_its_file_names_who_brings_it(bring, tmp_path):
    bring(("theirs", "spectra", {"mine": tmp_path / "a.csv"}))
    with pytest.raises(ValueError, match=r"'mine' of theirs 1.0 has no CSV or SPDX file"):
        spectra.check_illuminant("mine", 400.0, 700.0)


def test_a_brought_spectrum_stands_wherever_a_table_does(bring, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("wavelength_nm,a\n380,0.5\n830,1\n")
    registry = bring(("theirs", "spectra", {"mine": path}))
    edges = (400.0, 500.0, 700.0)
    assert spectra.illuminant("mine", edges) == pytest.approx([0.5 + 70 / 900, 0.5 + 220 / 900], rel=1e-12)
    assert spectra.luminance_of("mine") > 0
    assert spectra.camera_sensitivity("mine", edges)[0] == ("a",)
    kind = registry.load("optical_filter")
    coordinates = {"wavelength_edges": edges, "wavelength": (450.0, 600.0)}
    named, pathed = (kind(table=table) for table in ("mine", str(path)))
    assert list(named.prepare(coordinates)) == list(pathed.prepare(coordinates))
    assert parameters_for_key(named) == parameters_for_key(pathed)  # counted by what is in it
    path.write_text("wavelength_nm,a\n380,0.25\n830,0.5\n")
    assert spectra.illuminant("mine", edges) == pytest.approx(
        [0.25 + 35 / 900, 0.25 + 110 / 900], rel=1e-12
    )  # nothing stale is held


def test_a_near_miss_of_a_brought_name_is_told(bring, tmp_path):
    registry = bring(
        ("a", "spectra", {"my tungsten": tmp_path / "a.csv"}),
        ("b", "sensors", {"my-film": {}}),
        ("c", "stages", {"my_lens": "no.such:Lens"}),
    )
    with pytest.raises(ValueError, match="'my tungsten'"):
        spectra.check_illuminant("my tungstem", 400.0, 700.0)
    assert "did you mean 'my-film'?" in faults(registry, PIXEL, camera={"sensor": "my-filn"})
    assert "did you mean 'my_lens'?" in faults(registry, "my_lense")


WRONG = {
    "a word nobody reads": ({"unit": "um"}, "has an unknown key 'unit'; did you mean 'units'?"),
    "no unit": ({"units": "furlong"}, "unknown unit 'furlong'"),
    "an end that is no number": ({"above": "0"}, "above is '0'; expected a number"),
    "no mapping": (3, "is int; expected a mapping"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_quantity_that_cannot_be_read_is_told_with_who_brings_it(bring, case):
    value, reason = WRONG[case]
    bring(("theirs", "quantities", {"own": value}))
    with pytest.raises(PluginError) as caught:
        camera.quantity("own")
    assert "the camera quantity 'own' of theirs 1.0" in str(caught.value) and reason in str(caught.value)
    assert camera.quantity("f_number").default == 2.8


@pytest.mark.parametrize("value", [{"shown": "loud"}, {"range": (1, 0)}, {"name": "x"}, "text"])
def test_a_variable_that_cannot_be_read_is_told_with_who_brings_it(bring, value):
    bring(("theirs", "variables", {"own": value}))
    with pytest.raises(PluginError, match=r"the variable 'own' of theirs 1.0"):
        variables.variable("own")


@pytest.mark.parametrize(
    "value", [{}, "no_such_file.toml", 3, {"title": "a", "kind": "b", "description": "c", "camera": {"bits": 8}}]
)
def test_a_sensor_that_cannot_be_read_is_told_with_who_brings_it(bring, value):
    bring(("theirs", "sensors", {"own": value}))
    with pytest.raises(RequestError, match=r"the sensor 'own' of theirs 1.0 cannot be read"):
        presets.preset("own")


def test_a_table_and_its_presets_are_brought_by_hooks_of_a_domains_own():
    """``[film] stock = "grainy"``: neither the table, nor the word, nor the hook is one of the engine's."""
    point = Point("their-film", "tables", {"film": {"preset": "stock", "presets": "stocks"}})
    point.manifest.etendue_stocks = hookimpl(lambda: {"grainy": {"title": "t", "kind": "k", "description": "d"}})
    found = Discovery([point])
    assert found.names("stocks") == ["grainy"] and found.notes() == []
    other = Point("their-other", "stocks_of_nobody", {})
    assert "unknown hook 'etendue_stocks_of_nobody'" in str(Discovery([other]).notes())


def test_a_pipeline_in_python_is_written_under_the_table_that_it_names(bring):
    bring(("their-film", "tables", {"film": {}}))
    tables.tables.cache_clear()
    try:
        assert etendue.Pipeline(name="p").film(f_number=4).document()["film"] == {"f_number": 4}
        assert etendue.Pipeline(name="p").camera(f_number=4).document()["camera"] == {"f_number": 4}
    finally:
        tables.tables.cache_clear()
