"""The code behind a plugin's stage: whatever it reaches is in its key, however its distribution is laid out; what it
does not is not.
"""

import importlib
import itertools
import os
import shutil
import sys

import pytest

from etendue.plan.identity import code as code_of
from etendue.plan.identity import sources
from tests.plan.layouts import LAYOUTS, install, named, ours
from tests.plan.test_code import copied, forget

NUMBERS = itertools.count()


@pytest.fixture
def imported(tmp_path, monkeypatch):
    """Writes a layout into a folder of the path and imports its stage: the class, the folder, and the number in its
    names.
    """
    modules = set(sys.modules)
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    root = tmp_path / "path"
    root.mkdir()
    monkeypatch.syspath_prepend(str(root))

    def of(layout):
        n = str(next(NUMBERS))
        layout.written(n, root)
        if any(ours(name) for name in (*layout.edits, *layout.apart)):
            monkeypatch.setattr(sources, "PACKAGE", copied(tmp_path) / "etendue")
        importlib.invalidate_caches()
        return importlib.import_module(named(layout.module, n)).Added, root, n

    yield of
    for name in set(sys.modules) - modules:
        if not name.startswith("etendue"):
            del sys.modules[name]
    forget()


def now(kind):
    """The digest of a stage's code as another process would find it, and what it is made of."""
    forget()
    return code_of.code_digest(kind), dict(code_of.code_of(kind).sources)


def edit(path):
    """Another content; also where a clock is coarse, and where an editor keeps the size."""
    data, state = path.read_bytes(), path.stat()
    path.write_bytes(data + b"\n# edited\n" if path.suffix != ".csv" else b"2.0\n")
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns + 1_000_000_000))
    return data


FIRST = (
    "a package",
    "relative imports",
    "an import in a function",
    "a namespace package",
    "modules without a package",
    "a table beside the module",
    "kernels beside the manifest",
    "a built-in stage as a base",
    "an installed plugin",
    "an installed library that knows nothing of etendue",
    "an installed plugin with an import that cannot be followed",
    "code that is executed",
    "a compiled module",
)
EVERY = [pytest.param(LAYOUTS[title], id=title, marks=() if title in FIRST else pytest.mark.long) for title in LAYOUTS]


@pytest.mark.parametrize("layout", EVERY)
def test_an_edit_of_what_a_stage_reaches_is_seen_and_named_and_no_other(imported, layout):
    kind, root, n = imported(layout)
    place = lambda path: (sources.PACKAGE.parent if ours(path) else root) / named(path, n)  # noqa: E731
    before, own = now(kind)
    assert now(kind) == (before, own)
    for path, name in layout.edits.items():
        kept = edit(place(path))
        after, other = now(kind)
        assert after != before, path
        assert {one for one in {*own, *other} if own.get(one) != other.get(one)} >= {named(name, n)}
        place(path).write_bytes(kept)
        assert now(kind)[0] == before, path
    for path in layout.apart:
        edit(place(path))
        assert now(kind)[0] == before, path


def test_what_python_writes_and_what_is_hidden_does_not_count(imported):
    kind, root, n = imported(LAYOUTS["import_module of a name that is found"])
    before = now(kind)[0]
    for path in (
        f"found{n}/__pycache__/kernel.cpython-311.pyc",
        f"found{n}/.kernel.py.swp",
        f"found{n}/kernel.pyc",
        ".git/config",
    ):
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_bytes(b"anything")
    assert now(kind)[0] == before


def test_a_module_that_comes_to_be_where_an_import_looks_first_is_seen(imported):
    """As an optional library that is installed later."""
    kind, root, n = imported(LAYOUTS["imports on conditions"])
    before = now(kind)[0]
    (root / f"if{n}" / "absent.py").write_text("VALUE = 2.0\n")
    importlib.invalidate_caches()
    assert now(kind)[0] != before


def test_the_same_code_elsewhere_has_the_same_digest(imported, tmp_path, monkeypatch):
    """A worker on another machine, and a colleague's archive: no path of the machine, no time of a file."""
    layout = LAYOUTS["an installed library that knows nothing of etendue"]
    kind, root, n = imported(layout)
    before = now(kind)
    for name in [name for name in sys.modules if name.startswith((f"uses{n}", f"lib{n}", f"behind{n}"))]:
        del sys.modules[name]
    other = tmp_path / "__pycache__" / ".hidden" / "lib"  # which would be nothing to see below the folder of the code
    shutil.copytree(root, other)
    for path in other.rglob("*"):  # as of a copy that keeps no times: nothing is older than its record any more
        os.utime(path)
    monkeypatch.setattr(sys, "path", [str(other), *(p for p in sys.path if p != str(root))])
    importlib.invalidate_caches()
    again = importlib.import_module(named(layout.module, n)).Added
    assert str(other) in sys.modules[again.__module__].__file__
    assert now(again) == before


def test_a_library_that_is_built_anew_under_its_old_version_is_seen(imported):
    """As `pip install ./lib` does that was not given another number."""
    layout = LAYOUTS["an installed library that knows nothing of etendue"]
    kind, root, n = imported(layout)
    before = now(kind)[0]
    path = root / f"lib{n}" / "_lazy.py"
    path.write_text("VALUE = 2.0\n")
    install(root, f"lib{n}", f"Requires-Dist: behind{n}\n")
    os.utime(path, ns=(0, 0))
    assert now(kind)[0] != before


def test_libraries_of_the_engine_count_by_version_and_the_rest_of_an_environment_not_at_all(imported):
    kind, root, n = imported(LAYOUTS["a package"])
    (root / f"p{n}" / "kernel.py").write_text("import math, numpy, pandas.api as pd, PIL.Image, colour\nVALUE = 1.0\n")
    now(kind)
    assert code_of.libraries_of(kind) == {"pandas", "pillow", "colour-science"}  # numpy and scipy stand in the platform
    assert not any("pandas" in name or "numpy" in name for name in code_of.code_of(kind).sources)


def test_a_stage_on_labels_depends_on_xarray(imported):
    kind, root, n = imported(LAYOUTS["a package"])
    (root / f"p{n}" / "kernel.py").write_text("from etendue.api import labelled\nVALUE = 1.0\n")
    now(kind)
    assert code_of.libraries_of(kind) == {"xarray"}
    assert "etendue.contract.labelled" in code_of.code_of(kind).sources


def test_a_module_of_another_python_and_one_in_an_archive_count_as_they_are(imported, tmp_path, monkeypatch):
    kind, root, n = imported(LAYOUTS["a package"])
    (root / f"p{n}" / "kernel.py").write_text(
        "try:\n    import old\nexcept SyntaxError:\n    pass\nimport packed\nVALUE = 1.0\n"
    )
    (root / "old.py").write_text("print 'of another age'\n")
    (root / "zipped").mkdir()
    (root / "zipped" / "packed.py").write_text("VALUE = 1\n")
    shutil.make_archive(str(tmp_path / "packed"), "zip", root / "zipped")
    monkeypatch.syspath_prepend(str(tmp_path / "packed.zip"))
    before = now(kind)[0]
    (root / "old.py").write_text("print 'of another time'\n")
    changed = now(kind)[0]
    assert changed != before
    (root / "zipped" / "packed.py").write_text("VALUE = 2\n")
    shutil.make_archive(str(tmp_path / "packed"), "zip", root / "zipped")
    importlib.invalidate_caches()
    assert now(kind)[0] != changed
