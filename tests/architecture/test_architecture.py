"""The house stands as it was drawn: imports point one way, every stage keeps its declaration's form, every hook is
used.
"""

import ast
import importlib.metadata
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from etendue.contract.arrays.variables import variable
from etendue.contract.registry import installed_stages
from etendue.contract.stage import Stage, parameters_of, reads_of, writes_of
from etendue.plugins.discovery import installed
from etendue_camera import manifest

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src"
PACKAGE = SOURCE / "etendue"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
REGISTRY = installed_stages()


def test_every_import_contract_holds(tmp_path):
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "from importlinter.cli import lint_imports_command; lint_imports_command()",
            "--config",
            str(ROOT / "pyproject.toml"),
            "--no-cache",
        ],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr
    contracts = len(PROJECT["tool"]["importlinter"]["contracts"])
    assert f"{contracts} kept, 0 broken" in done.stdout


def test_no_file_is_named_after_nothing():
    """Files are named after what they compute."""
    names = {path.stem for path in SOURCE.rglob("*.py")}
    assert not names & {"utils", "util", "helpers", "helper", "common", "misc", "tools", "base", "core"}


def test_the_types_of_the_package_are_there_for_who_imports_it():
    """Without ``py.typed`` a type checker takes everything of an installed package for Any."""
    assert (PACKAGE / "py.typed").read_text() == ""
    assert PROJECT["tool"]["mypy"]["strict"] is True


def modules():
    return [path for path in sorted(SOURCE.rglob("*.py")) if path.read_text().strip()]


def test_a_file_starts_by_saying_what_it_is_about():
    assert not [path for path in modules() if not ast.get_docstring(ast.parse(path.read_text()))]


def test_no_import_stands_in_a_function_to_break_a_circle():
    """An import of ours inside a function is there to save time at start; the doors of the house are the only
    places.
    """
    late = {  # what object stores need is dear, and a unit stands in the code behind transfer functions alone
        "etendue/__init__.py",
        "etendue/__main__.py",
        "etendue/api.py",
        "etendue/session.py",
        "etendue/archive/places.py",
        "etendue/contract/arrays/dims.py",
        "etendue/plugins/guests.py",  # which discovery starts
        "etendue_camera/export/archived.py",  # a method of archives
    }
    asked = ("cli", "bodies", "builder", "accuracy", "trust")
    found = []
    for path in modules():
        inside = path.relative_to(SOURCE)
        if str(inside) in late or inside.parts[0] == "etendue_lab" or inside.parent.name in asked:
            continue
        for function in ast.walk(ast.parse(path.read_text())):
            if isinstance(function, ast.FunctionDef):
                imports = [n.module or "" for n in ast.walk(function) if isinstance(n, ast.ImportFrom)]
                found += [f"{inside}:{function.name} {name}" for name in imports if name.startswith("etendue")]
    assert found == []


def test_the_house_stands_as_it_is_drawn_for_who_contributes():
    """Every room, subject and study is named, and what is named is there."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    drawn = set(re.findall(r"[a-z_]+", text.split("## Architecture")[1].split("## Making a change")[0]))
    rooms = {path.stem for path in PACKAGE.iterdir() if not path.name.startswith(("_", "py.typed"))}
    houses = (SOURCE / "etendue_camera", SOURCE / "etendue_lab")
    behind = {path.name for house in houses for path in house.iterdir() if (path / "__init__.py").is_file()}
    assert rooms | behind <= drawn
    outside = ("docs", "benchmarks", "plugins", "tests", "src")
    paths = [path for path in re.findall(r"`([a-z_]+/[\w./-]*)`", text) if path.split("/")[0] not in outside]
    assert len(paths) > 20
    places = (SOURCE, PACKAGE, *houses)
    assert [path for path in paths if not any((place / path).exists() for place in places)] == []


def test_every_import_that_the_documents_show_is_there():
    texts = [path.read_text() for path in (ROOT / "README.md", *(ROOT / "docs").glob("*.md"))]
    shown = [
        line
        for text in texts
        for line in re.findall(r"^ *(from etendue(?:_camera)?[. ][\w.]*? ?import [\w, ]+)$", text, flags=re.M)
    ]
    assert len(shown) > 8
    for line in shown:
        exec(line.strip(), {})


def test_no_law_hangs_on_a_clock():
    """Speed is measured in ``benchmarks``: how fast a machine is at the moment is no property of the code."""
    clocks = {"time", "perf_counter", "process_time", "thread_time", "monotonic"}
    found = []
    for path in sorted((ROOT / "tests").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Assert):
                called = {
                    n.func.attr for n in ast.walk(node) if isinstance(n, ast.Call) and isinstance(n.func, ast.Attribute)
                }
                found += [f"{path.name}:{node.lineno}" for _ in called & clocks]
    assert found == []


# -- built-in stages --------------------------------------------------------------------------------------

BUILT_IN = sorted(manifest.etendue_stages())


def test_two_entry_points_bring_all_that_is_built_in():
    installed = {
        p.name: p.value
        for p in importlib.metadata.distribution("etendue").entry_points
        if p.group.startswith("etendue")
    }
    assert (
        installed
        == {"camera": manifest.__name__, "lab": "etendue_lab.manifest"}
        == PROJECT["project"]["entry-points"]["etendue"]
    )
    assert {n for n in REGISTRY.names() if REGISTRY.installed(n).distribution == "etendue"} == set(BUILT_IN)


def test_every_stage_class_of_a_module_stands_in_the_manifest():
    """A class with a role, reads or writes of its own that no name leads to is nobody's."""
    named = {REGISTRY.load(name) for name in BUILT_IN}
    modules = {kind.__module__ for kind in named}
    found = {
        kind
        for module in modules
        for kind in vars(sys.modules[module]).values()
        if isinstance(kind, type)
        and issubclass(kind, Stage)
        and kind.__module__ == module
        and not kind.__name__.startswith("_")
        and "run" in vars(kind)
    }
    assert found - named == set()


@pytest.mark.parametrize("name", BUILT_IN)
def test_what_a_built_in_stage_says_is_said_in_the_vocabularies(name):
    """Its role has a sentence; its variables have a meaning, and there the unit in which it writes them."""
    kind, brought = REGISTRY.load(name), installed()
    assert brought.first("roles", kind.role), (
        f"{name} has the role {kind.role!r}, of which data/roles.toml says nothing"
    )
    for declaration in writes_of(kind).values():
        assert brought.first("variables", declaration.variable), declaration
        assert variable(declaration.variable).units == declaration.unit, declaration


def test_no_vocabulary_speaks_of_what_is_not_there():
    kinds = [REGISTRY.load(name) for name in BUILT_IN]
    written = {declaration.variable for kind in kinds for declaration in writes_of(kind).values()}
    assert set(manifest.etendue_variables()) - written == set()
    assert set(manifest.etendue_roles()) - {kind.role for kind in kinds} == set()
    taken = {name for kind in kinds for name, (parameter, _, _) in parameters_of(kind).items() if parameter.shared}
    assert set(manifest.etendue_quantities()) - taken == set()


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_entry_point_loads_and_its_stage_says_what_it_is_and_how_wrong(name):
    kind = REGISTRY.load(name)
    assert issubclass(kind, Stage)
    assert kind.__doc__
    assert not kind.__doc__.startswith(f"{kind.__name__}(")  # what a dataclass writes where nobody wrote anything
    assert callable(getattr(kind, "error", None)), f"{name} gives no error estimate"
    assert callable(getattr(kind, "run", None)) != callable(getattr(kind, "transfer", None))
    assert writes_of(kind)


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_parameter_with_a_unit_or_a_range_says_so_in_its_declaration(name):
    for key, (parameter, kind, _) in parameters_of(REGISTRY.load(name)).items():
        assert kind in (float, int, str, bool) or str(kind).startswith("tuple"), f"{name}.{key} is a {kind}"
        if parameter.fidelity:
            assert parameter.reference, f"{name}.{key} names no reference"


def test_every_variable_has_one_unit_and_one_set_of_dims():
    """A name carries one meaning for ever: two stages cannot disagree. Of exposures ``frame`` leads, of a mosaic's
    planes ``channel``.
    """
    found = {}
    for name in BUILT_IN:
        kind = REGISTRY.load(name)
        for declaration in [*writes_of(kind).values(), *reads_of(kind).values()]:
            if declaration.variable.startswith("*."):
                continue
            planes = ("channel",) if declaration.variable in ("photocurrent", "mosaic_linear") else ()
            own = tuple(dim for dim in declaration.dims if dim not in ("...", "frame", *planes))
            stated = (own, declaration.unit, declaration.dtype)
            first, known = found.setdefault(declaration.variable, (name, stated))
            assert known == stated, f"{declaration.variable} is {stated} for {name}, but {known} for {first}"


def defines(attribute):
    return [name for name in BUILT_IN if callable(getattr(REGISTRY.load(name), attribute, None))]


def declares(attribute):
    return [name for name in BUILT_IN if getattr(REGISTRY.load(name), attribute) != getattr(Stage, attribute)]


USES = {
    "grid": lambda: defines("grid"),
    "prepare": lambda: defines("prepare"),
    "transfer": lambda: defines("transfer"),
    "negligible": lambda: defines("negligible"),
    "carry": lambda: defines("carry"),
    "describe": lambda: defines("describe"),
    "error": lambda: defines("error"),
    "warn": lambda: defines("warn"),
    "gain": lambda: declares("gain"),
    "negative = keep": lambda: [n for n in BUILT_IN if REGISTRY.load(n).negative == "keep"],
    "negative = clip": lambda: [n for n in BUILT_IN if REGISTRY.load(n).negative == "clip"],
    "nan": lambda: declares("nan") + [n for n in BUILT_IN if any(d.nan for d in writes_of(REGISTRY.load(n)).values())],
    "libraries": lambda: declares("libraries"),
    "fidelity": lambda: [
        n for n in BUILT_IN if any(p.fidelity for p, _, _ in parameters_of(REGISTRY.load(n)).values())
    ],
}


@pytest.mark.parametrize("what", USES)
def test_everything_a_stage_may_say_is_said_by_at_least_two(what):
    """What one stage alone uses is a special case in disguise, and belongs to that stage."""
    assert len(set(USES[what]())) >= 2


def test_a_policy_is_one_of_those_the_engine_knows():
    for name in BUILT_IN:
        kind = REGISTRY.load(name)
        assert kind.negative in ("error", "keep", "clip"), name
        assert kind.nan in ("error", "keep"), name
        assert kind.gain is None or kind.gain >= 0, name


def test_what_commands_make_in_a_checkout_is_no_change_of_it():
    """Archives by the names of the pipelines, and what README and docs export and compare into."""
    inside = (
        subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True) if shutil.which("git") else None
    )
    if inside is None or not inside.stdout:
        pytest.skip("no checkout")
    names = [tomllib.loads(path.read_text())["name"] for path in (ROOT / "pipelines").glob("*.toml")]
    texts = [path.read_text() for path in (ROOT / "README.md", *(ROOT / "docs").glob("*.md"))]
    names += [
        name
        for text in texts
        for name in re.findall(r"^\$? ?etendue .*(?:--archive|--output|-o) (\w[\w.]*)", text, flags=re.M)
    ]
    names += [f"{name}-export" for name in names if "." not in name] + ["paper_physical-compare-demosaic", ".venv-test"]
    made = [f"{name}/" if "." not in name.lstrip(".") else name for name in names]
    seen = subprocess.run(["git", "check-ignore", *made], cwd=ROOT, capture_output=True, text=True).stdout.splitlines()
    assert set(made) - set(seen) == set()
    ours = subprocess.run(
        ["git", "ls-files", "-i", "-c", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True
    ).stdout
    assert ours == ""
