"""The code behind built-in stages: what can change a bit of a cell is in its key, what cannot is not."""

import os
import shutil
from contextlib import contextmanager
from pathlib import Path

import pytest

from etendue.contract.capabilities import is_random, is_transfer
from etendue.contract.registry import installed_stages
from etendue.plan.identity import code as code_of
from etendue.plan.identity import distributions, sources
from etendue.plan.identity.engine import ENGINE, HELD, MOVES, TRANSFER_KERNELS, only_moves
from etendue.plugins import discovery

BUILT_IN = sorted(
    name for name in installed_stages().names() if installed_stages().installed(name).distribution == "etendue"
)


def forget():
    """What a process remembers of code."""
    for module in (code_of, sources, distributions):
        for found in vars(module).values():
            if hasattr(found, "cache_clear"):
                found.cache_clear()


def copied(folder, bytecode=False):
    """The packages of the distribution in another folder."""
    for name in discovery.own_packages():
        hidden = () if bytecode else ("__pycache__", ".*")
        shutil.copytree(sources.PACKAGE.parent / name, folder / name, ignore=shutil.ignore_patterns(*hidden))
    return folder


@pytest.fixture(scope="module")
def code(tmp_path_factory):
    """A copy of the packages that a test may edit: their folder, a way to the digests of all built-in stages, and
    those unedited.
    """
    packages = copied(tmp_path_factory.mktemp("code"))

    def digests():
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sources, "PACKAGE", packages / "etendue")
            forget()
            try:
                return {name: code_of.code_digest(installed_stages().load(name)) for name in BUILT_IN}
            finally:
                forget()

    return packages, digests, digests()


@contextmanager
def edited_files(*paths):
    texts = [path.read_text() for path in paths]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text + "\n# edited\n")
    yield
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text)


STAGES = {
    "optics": {"irradiance", "optical_filter"},
    "lens": {"diffraction", "lens_gaussian", "lens_psf"},
    "sensor": {"diffusion", "pixel", "crosstalk"},
    "reconstruct": {
        "demosaic_nearest",
        "demosaic_bilinear",
        "demosaic_colour_difference",
        "demosaic_directional",
        "demosaic_any",
    },
    "random": {name for name in BUILT_IN if is_random(installed_stages().load(name))},
    "transfer": {name for name in BUILT_IN if is_transfer(installed_stages().load(name))},
}


@pytest.mark.parametrize(
    ("edited", "must", "must_not"),
    [
        (
            "etendue_camera/mosaic/bilinear.py",
            STAGES["reconstruct"],
            STAGES["optics"] | STAGES["sensor"] | {"uniform", "encode", "shot_noise"},
        ),
        (
            "etendue_camera/sensor/photodiode.py",
            STAGES["sensor"] | {"white", "colour_fit"},
            STAGES["optics"] | STAGES["reconstruct"] | {"uniform"},
        ),
        (
            "etendue_camera/sensor/cfa.py",
            STAGES["reconstruct"] | STAGES["sensor"] | {"mosaic", "white"},
            STAGES["optics"] | {"uniform", "shot_noise"},
        ),
        (
            "etendue_camera/optics/airy.py",
            STAGES["lens"] | {"lens_numbers"},
            STAGES["optics"] | STAGES["sensor"] | STAGES["reconstruct"] | {"uniform", "encode"},
        ),
        ("etendue/transfer/sampling.py", STAGES["transfer"], STAGES["reconstruct"] | {"adc", "lens_numbers"}),
        ("etendue/transfer/expansion.py", STAGES["transfer"], STAGES["reconstruct"] | {"adc", "lens_numbers"}),
        (
            "etendue_camera/electronics/noise.py",
            {"shot_noise"},
            STAGES["reconstruct"] | STAGES["transfer"] | {"linearise"},
        ),
        (
            "etendue_camera/sensor/stages/sensitivity.py",
            STAGES["sensor"] | {"white", "colour_fit"},
            STAGES["optics"] | STAGES["reconstruct"],
        ),
        ("etendue_camera/picture_files.py", {"photograph"}, STAGES["optics"] | STAGES["reconstruct"] | {"uniform"}),
        ("etendue_camera/data/silicon_absorption.csv", STAGES["sensor"] | {"white"}, STAGES["reconstruct"] | {"adc"}),
        (
            "etendue_camera/data/spectra.npz",
            {"uniform", "photograph", "camera_to_xyz"},
            STAGES["reconstruct"] | {"adc"},
        ),
        *((f"{module.replace('.', '/')}.py", set(BUILT_IN), set()) for module in ENGINE),
    ],
)
def test_an_edited_file_is_seen_by_the_stages_that_reach_it_and_by_no_others(code, edited, must, must_not):
    packages, digests, before = code
    path, kept = packages / edited, (packages / edited).read_bytes()
    path.write_bytes(kept + b"\n# edited\n")
    after = digests()
    path.write_bytes(kept)
    seen = {name for name in BUILT_IN if before[name] != after[name]}
    assert must <= seen
    assert not must_not & seen


def test_an_edit_of_what_moves_or_shows_results_changes_no_key(code):
    packages, digests, before = code
    rooms = (
        "accuracy",
        "archive",
        "builder",
        "cli",
        "pipeline",
        "plan",
        "plugins",
        "present",
        "run",
        "testing",
        "trust",
    )
    shown = [
        *(f"etendue/{room}" for room in rooms),
        "etendue_lab",
        *(f"etendue_camera/{room}" for room in ("cli", "export", "importing")),
    ]
    keyed = {packages / f"{module.replace('.', '/')}.py" for module in ENGINE}
    names = [path for folder in shown for path in (packages / folder).rglob("*.py") if path not in keyed]
    names += [
        packages / "etendue" / name
        for name in ("session.py", "errors.py", "telling.py", "contract/registry.py", "contract/arrays/dims.py")
    ]
    names += [
        packages / "etendue_camera" / name for name in ("manifest.py", "data/variables.toml", "data/quantities.toml")
    ]
    assert len(names) > 150
    with edited_files(*names):
        assert digests() == before


def test_every_module_that_the_engine_imports_is_in_a_list_or_a_kernel_in_the_digests_of_its_kind():
    """No edit of a module that is on the way of a cell goes unseen because nobody thought of it."""
    kernels = {*TRANSFER_KERNELS}
    reached = set(code_of._reached(kernels).sources) | {name.rpartition(".")[0] for name in kernels}
    for module in ENGINE:
        for name in sources.known(code_of._own_file(module)).imports:
            if name.startswith("etendue.") and code_of._own_file(name):
                assert name in ENGINE or only_moves(name) or name in reached, f"{module} imports {name}"


def test_the_lists_name_modules_that_there_are_once_and_with_a_reason():
    assert len(set(ENGINE)) == len(ENGINE)
    assert not set(ENGINE) & set(MOVES)
    assert all(only_moves(module) and module not in MOVES for module in HELD)
    for module in (*ENGINE, *MOVES, *HELD, *TRANSFER_KERNELS):
        path = sources.PACKAGE.parent / Path(*module.removesuffix(".*").split("."))
        assert path.with_suffix(".py").is_file() or (path / "__init__.py").is_file(), module
    assert all(len(reason) > 5 for reason in MOVES.values())
    for module in (
        "etendue.archive.write.store",
        "etendue.cli",
        "etendue.plan.wiring.graph",
        "etendue.present.terminal.tables",
        "etendue.contract.arrays.dims",
    ):
        assert only_moves(module)
    for module in (
        "etendue.compute.rows",
        "etendue.compute.tables",
        "etendue.contract.values.units",
        "etendue.transfer.sampling",
        "etendue.transfer.effects",
    ):
        assert not only_moves(module)


def test_no_import_of_what_a_built_in_stage_reaches_is_hidden():
    """The doors `api` and `etendue_camera.models` import what is asked for: what is taken out of them is followed by
    its name.
    """
    for name in BUILT_IN:
        for module in code_of.code_of(installed_stages().load(name)).sources:
            own = module.partition(".")[0] in discovery.own_packages()
            file = code_of._own_file(module) if own else None
            assert file is None or not sources.known(file).hides, module


def test_a_built_in_stage_names_the_libraries_that_its_code_imports():
    """One who reads a stage sees what its key depends on; spectra ask colour-science for what is not shipped."""
    for name in BUILT_IN:
        kind = installed_stages().load(name)
        assert code_of.code_of(kind).libraries - set(kind.libraries) <= {"colour-science"}, name


def test_what_is_kept_of_a_file_between_runs_is_forgotten_with_it(code, tmp_path, monkeypatch):
    """Also of one that was edited to the same size and given its old time: not every editor is honest about time."""
    packages, digests, before = code
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path))
    edited = packages / "etendue_camera/mosaic/bilinear.py"
    text, state = edited.read_text(), edited.stat()
    monkeypatch.setattr(sources, "SETTLED", 0.0)  # other tests have edited files just now
    assert digests() == before  # found, and kept
    reads = []
    monkeypatch.setattr(sources, "_read", lambda path, read=sources._read: reads.append(path.name) or read(path))
    assert digests() == before and reads == []
    edited.write_text(text.replace("mean", "neam", 1))
    os.utime(edited, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert edited.stat().st_size == state.st_size
    after = digests()
    assert {name for name in BUILT_IN if before[name] != after[name]} >= STAGES["reconstruct"] and set(reads) == {
        "bilinear.py"
    }
    edited.write_text(text)
    assert digests() == before
    for kept in (tmp_path / "code").iterdir():
        kept.write_bytes(kept.read_bytes()[:-9])
    assert digests() == before


def test_a_copy_of_the_package_elsewhere_has_the_same_digests(code):
    elsewhere = code[2]
    assert len(set(elsewhere.values())) > 5
    assert elsewhere == {name: code_of.code_digest(installed_stages().load(name)) for name in BUILT_IN}


def test_what_a_scene_was_found_to_hold_is_kept_under_the_code_that_has_found_it(code):
    package = code[0] / "etendue"
    found = []
    for edited in (
        "transfer/rings.py",
        "transfer/contents.py",
        "contract/arrays/coordinates.py",
        "present/terminal/tables.py",
    ):
        with pytest.MonkeyPatch.context() as patch, edited_files(package / edited):
            patch.setattr(sources, "PACKAGE", package)
            forget()
            found.append(code_of.code_at("etendue.transfer.contents"))
    forget()
    assert len(set(found)) == 4 and found[-1] == code_of.code_at("etendue.transfer.contents")
