"""No stage is recognised by its name or its class outside its own file: what it is stands in its role, its
declarations and its bases.
"""

import ast
import inspect
from functools import cache
from pathlib import Path

from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of, reads_of, writes_of
from etendue.contract.values import quantities as camera

PACKAGE = Path(__file__).parents[2] / "src"
FILES = sorted(PACKAGE.rglob("*.py"))
OTHER_WORDS = {
    "colorchecker": "a table of spectra",
    "diffraction": "physics that is met once on the way",
    "dynamic_range": "a figure of a measurement",
    "mosaic": "a figure of a study's document",
    "photon_transfer": "a curve, in a document of a study",
    "points": "of a curve, in a document of a study",
    "uniform": "a fact of a scene",
    "zone_plate": "a part of a chart",
}
"""Words that mean something else where they stand; variables, parameters and roles are known anyhow."""


@cache
def parsed(path):
    return ast.parse(path.read_text())


@cache
def own_names():
    """Names of the stages of the package, and the file of each."""
    registry = installed_stages()
    ours = [name for name in registry.names() if registry.installed(name).distribution == "etendue"]
    return {name: Path(inspect.getfile(registry.load(name))) for name in ours}


@cache
def vocabulary():
    """What is no name of a stage, though it may be spelt like one: variables, quantities, parameters, roles, dims."""
    words = {*camera.names(), *OTHER_WORDS}
    for name in own_names():
        kind = installed_stages().load(name)
        declared = [*reads_of(kind).values(), *writes_of(kind).values()]
        words |= (
            {d.variable for d in declared}
            | {dim for d in declared for dim in d.dims}
            | set(parameters_of(kind))
            | {kind.role}
        )
    return words


def recognising(tree):
    """Strings that something is compared with or looked up in, or a stage is put into a pipeline by; their lines;
    whether the last.
    """
    for node in ast.walk(tree):
        found, put = [], []
        if isinstance(node, ast.Compare):
            found = [node.left, *node.comparators]
        elif isinstance(node, ast.Call):
            loading = isinstance(node.func, ast.Attribute) and node.func.attr == "load"
            (put if loading else found).extend(node.args)
            for word in node.keywords:
                (put if word.arg == "use" else found).append(word.value)
        elif isinstance(node, ast.Set | ast.List | ast.Tuple):
            found = node.elts
        elif isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                found.append(key)
                (put if isinstance(key, ast.Constant) and key.value == "use" else found).append(value)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            found = [node.value]
        for one in [*found, *put]:
            if isinstance(one, ast.Constant) and isinstance(one.value, str):
                yield one.value, one.lineno, one in put


def test_no_file_knows_a_stage_of_another_by_name():
    found = {
        (path, word, line)
        for path in FILES
        for word, line, put in recognising(parsed(path))
        if own_names().get(word, path) != path and (put or word not in vocabulary())
    }
    assert not found


def test_the_words_that_mean_something_else_are_names_of_stages():
    """The list holds nothing that needs no excuse."""
    assert set(OTHER_WORDS) <= set(own_names())


NAMING = ("use", "uses")


def test_no_file_looks_into_the_name_under_which_a_stage_is_installed():
    """``entry.use == "x"``, ``"x" in one.use``, ``use.startswith("x")``: letters of a name say nothing of a stage."""
    found = []
    for path, node in ((file, node) for file in FILES for node in ast.walk(parsed(file))):
        parts = []
        if isinstance(node, ast.Compare):
            parts = [node.left, *node.comparators]
        elif (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr in ("startswith", "endswith")
        ):
            parts = [node.func.value, *node.args]
        named = any(
            isinstance(p, ast.Attribute | ast.Name) and (p.attr if isinstance(p, ast.Attribute) else p.id) in NAMING
            for p in parts
        )
        letters = any(isinstance(p, ast.Constant) and isinstance(p.value, str) and p.value for p in parts)
        found += [(path, node.lineno)] if named and letters else []
    assert not found


def test_classes_of_stages_are_known_in_their_own_wing_alone():
    """Outside of ``stages`` none is imported; inside, what a stage is is not asked by the class of another subject."""
    assert not {path: known for path in FILES if (known := _known_elsewhere(path))}


def _known_elsewhere(path):
    tree, inside = parsed(path), path.relative_to(PACKAGE).parts
    imported = {
        alias.name: n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module for alias in n.names
    }
    stages = {
        name: module
        for name, module in imported.items()
        if ".stages" in module and module.startswith("etendue_camera.")
    }
    if inside[0] != "etendue_camera" or "stages" not in inside:
        return set(stages)
    others = {name for name, module in stages.items() if module.split(".")[1] != inside[1]}
    asked = [
        n.args[1] for n in ast.walk(tree) if isinstance(n, ast.Call) and _called(n) in ("isinstance", "issubclass")
    ]
    return {name.id for one in asked for name in ast.walk(one) if isinstance(name, ast.Name)} & others


def _called(call):
    return call.func.id if isinstance(call.func, ast.Name) else ""
