"""Plugins that are broken or clash fail only what uses them. They are installed as a folder on PYTHONPATH."""

import json
import os
import subprocess
import sys
from textwrap import dedent

import pytest

from tests.fresh import process

MODULE = """
from dataclasses import dataclass
from etendue.api import Stage

@dataclass(frozen=True, kw_only=True)
class Twice(Stage):
    '''Twice the light.'''
    reads = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    def run(self, irradiance):
        return {"irradiance": 2 * irradiance}
"""
HOOK = """
from etendue.api import hookimpl

@hookimpl
def etendue_{what}():
    return {value}
"""


def hook(what, value):
    """A manifest with one hook."""
    return HOOK.format(what=what, value=value)


def install(folder, distribution, module, source, group="etendue"):
    """A distribution whose entry point is a module of this source, as pip would leave it."""
    info = folder / f"{distribution}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{group}]\ntwice = {module}\n")
    (folder / f"{module}.py").write_text(dedent(source))


def install_twice(folder, source=MODULE, name="twice", kind="Twice", distribution="twice-light"):
    """A distribution with a stage in a module of its own."""
    module = distribution.replace("-", "_")
    install(folder, distribution, module, hook("stages", {name: f"{module}_stages:{kind}"}))
    (folder / f"{module}_stages.py").write_text(source)


@pytest.fixture
def etendue(tmp_path):
    def call(*arguments):
        return process(
            *arguments, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(tmp_path / "plugins"), "COLUMNS": "200"}
        )

    return call


def pipeline(folder, *uses):
    text = (
        '[[stages]]\nuse = "uniform"\nwhite_luminance = "1000 cd m-2"\nwidth = "8 um"\nheight = "8 um"\nbin_width = '
        '"100 nm"\n'
    )
    (folder / "file.toml").write_text(text + "".join(f'[[stages]]\nuse = "{use}"\n' for use in ("irradiance", *uses)))
    return "file.toml"


BROKEN = {
    "raises": ("raise RuntimeError('no driver')", "RuntimeError: no driver"),
    "has_no_class": ("x = 1", "has no attribute 'Twice'"),
    "has_no_declaration": (
        MODULE.replace("wavelength y x [W m-2 nm-1]", "wavelength y x"),
        "cannot read the declaration",
    ),
    "takes_anything": (MODULE.replace("self, irradiance", "self, **anything"), "name every argument"),
    "asks_for_more": (MODULE.replace("self, irradiance", "self, irradiance, radiance"), "asks for radiance"),
    "is_no_stage": ("Twice = 3", "is not a valid stage"),
    "takes_what_nobody_brings": (
        MODULE.replace("import Stage", "import Stage, quantity").replace(
            "    reads", "    own: float = quantity('f_numbre')\n    reads"
        ),
        "unknown camera quantity 'f_numbre'; did you mean 'f_number'?",
    ),
    "exits": ("import sys; sys.exit(7)", "SystemExit"),
}


@pytest.mark.long
@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_stage_fails_only_what_uses_it_and_is_listed_as_broken(etendue, tmp_path, case):
    source, reason = BROKEN[case]
    install_twice(tmp_path / "plugins", source)
    used = etendue("plan", pipeline(tmp_path, "twice"))
    assert (used.returncode, used.stdout) == (2, "")
    assert "Traceback" not in used.stderr
    assert len(used.stderr.splitlines()) == 1
    for text in ("file.toml:", "stages[3] twice", "twice-light 1.0", reason):
        assert text in used.stderr
    listed = etendue("stages", "--json")
    assert listed.returncode == 0
    (broken,) = [document for document in json.loads(listed.stdout) if "broken" in document]
    assert broken["name"] == "twice"
    assert reason in broken["broken"]


BROKEN_MANIFESTS = {
    "raises": ("raise RuntimeError('no driver')", "RuntimeError: no driver"),
    "exits": ("import sys; sys.exit(7)", "SystemExit"),
    "has_no_hook": ("x = 1", "has no @hookimpl of etendue"),
    "misspells_its_hook": (hook("stagez", "{}"), "unknown hook 'etendue_stagez'"),
    "breaks_off": (hook("stages", "1 / 0"), "etendue_stages failed: ZeroDivisionError"),
    "gives_a_list": (hook("stages", "['twice']"), "etendue_stages returned list; expected a mapping by name"),
}


@pytest.mark.long
@pytest.mark.parametrize("case", BROKEN_MANIFESTS)
def test_a_broken_manifest_fails_only_what_uses_it_and_is_noted(etendue, tmp_path, case):
    source, reason = BROKEN_MANIFESTS[case]
    install(tmp_path / "plugins", "twice-light", "twice_light", source)
    used = etendue("plan", pipeline(tmp_path, "twice"))
    assert (used.returncode, used.stdout) == (2, "")
    assert len(used.stderr.splitlines()) == 1
    for text in ("file.toml:", "stages[3] twice", "unknown stage 'twice'", "twice-light 1.0", reason):
        assert text in used.stderr
    assert etendue("plan", pipeline(tmp_path, "falloff")).returncode == 0
    listed = etendue("stages")
    assert listed.returncode == 0
    (note,) = listed.stderr.splitlines()
    assert note.startswith("note: twice-light 1.0") and reason in note


def test_a_role_that_nobody_declares_works_and_is_noted(etendue, tmp_path):
    install_twice(tmp_path / "plugins", MODULE.replace("    reads", "    role = 'loudness'\n    reads"))
    assert etendue("plan", pipeline(tmp_path, "twice")).returncode == 0
    assert "note: no distribution describes the role 'loudness' of twice in etendue_roles()" in etendue("stages").stdout


def test_a_distribution_of_the_form_of_earlier_versions_is_told_what_to_write(etendue, tmp_path):
    install(tmp_path / "plugins", "twice-light", "twice_light", MODULE, group="etendue.stages")
    for done in (etendue("plan", pipeline(tmp_path, "twice")), etendue("stages"), etendue("stages", "twice")):
        (line,) = done.stderr.splitlines()
        for text in (
            "twice-light 1.0",
            "'etendue.stages'",
            "[project.entry-points.etendue]",
            "'twice_light'",
            "etendue_stages()",
        ):
            assert text in line


def test_beside_a_broken_plugin_everything_else_goes_on(etendue, tmp_path):
    install_twice(tmp_path / "plugins", "raise RuntimeError('no driver')")
    assert etendue("plan", pipeline(tmp_path, "falloff")).returncode == 0
    listed = etendue("stages")
    assert listed.returncode == 0
    assert any(line.startswith("broken: twice: ") and "no driver" in line for line in listed.stdout.splitlines())


def test_a_working_plugin_is_found_listed_and_planned(etendue, tmp_path):
    install_twice(tmp_path / "plugins")
    document = json.loads(etendue("plan", pipeline(tmp_path, "twice"), "--json").stdout)
    assert document["stages"][-1]["distribution"] == "twice-light"
    assert "Twice the light." in etendue("stages", "twice").stdout


def test_two_distributions_that_offer_one_name_are_a_fault_naming_both(etendue, tmp_path):
    for distribution in ("twice-light", "more-light"):  # no module of a stage is looked at for it
        install_twice(tmp_path / "plugins", "raise RuntimeError('looked at')", distribution=distribution)
    used = etendue("plan", pipeline(tmp_path, "twice"))
    assert used.returncode == 2
    assert "more-light" in used.stderr
    assert "twice-light" in used.stderr
    assert etendue("plan", pipeline(tmp_path)).returncode == 0
    listed = etendue("stages", "twice").stdout
    assert "more-light" in listed
    assert "twice-light" in listed


def test_a_plugin_may_not_take_the_name_of_a_built_in_stage_unseen(etendue, tmp_path):
    install_twice(tmp_path / "plugins", name="falloff", distribution="my-optics")
    used = etendue("plan", pipeline(tmp_path, "falloff"))
    assert used.returncode == 2
    assert "my-optics" in used.stderr
    assert "etendue" in used.stderr


def test_the_same_distribution_found_twice_is_no_clash(tmp_path):
    """A folder that stands twice on the path, as with an editable installation beside its own sources."""
    install_twice(tmp_path / "plugins")
    done = subprocess.run(
        [sys.executable, "-m", "etendue", "plan", pipeline(tmp_path, "twice")],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(tmp_path / "plugins"), str(tmp_path / "plugins" / ".." / "plugins")]),
        },
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("use", ["no such stage", "../twice", "twice\\u0000"])
def test_a_name_that_cannot_be_a_stage_is_a_fault(etendue, tmp_path, use):
    done = etendue("plan", pipeline(tmp_path, use))
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
