"""The house in figures: how much there is of it, and of what should be little; by folder with --folders.

    python benchmarks/house.py [--root .] [--folders] [--against benchmarks/house.json] [--write benchmarks/house.json]

With --against a figure above the recorded one ends in 1: a commit that needs more records it with --write, and says so.
Code lines are those that are neither blank, comment nor docstring.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

SKIPPED = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
FEW = 3  # lines of a body that may as well stand where it is called
MANY = 8  # parameters
HARD = 20  # paths through a function, by radon
FULL = 15  # files of a folder


class Source:
    """A file: its text, its tree, its lines of code."""

    def __init__(self, path: Path, root: Path) -> None:
        self.path, self.text = path.relative_to(root), path.read_text()
        self.tree = ast.parse(self.text)
        self.code = _code_lines(self.text, self.tree)

    def functions(self) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
        return (node for node in ast.walk(self.tree) if isinstance(node, FUNCTIONS))


def _code_lines(text: str, tree: ast.Module) -> int:
    words = set()
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and ast.get_docstring(node, clean=False) is not None
        ):
            first = node.body[0]
            words |= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    found = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in SKIPPED:
            found |= set(range(token.start[0], token.end[0] + 1))
    return len(found - words)


def _loose_types(source: Source) -> int:
    """``Any``, annotations that say ``object``, casts, and what mypy is told to overlook."""
    notes = [node.annotation for node in ast.walk(source.tree) if isinstance(node, ast.arg | ast.AnnAssign)]
    notes += [one.returns for one in source.functions()]
    objects = sum(
        isinstance(name, ast.Name) and name.id == "object"
        for note in notes
        if note is not None
        for name in ast.walk(note)
    )
    casts = sum(
        isinstance(node, ast.Call) and "cast" in (getattr(node.func, "id", ""), getattr(node.func, "attr", ""))
        for node in ast.walk(source.tree)
    )
    said = [getattr(node, "id", getattr(node, "attr", getattr(node, "name", ""))) for node in ast.walk(source.tree)]
    return said.count("Any") + objects + casts + source.text.count("type: ignore")


def _body(function: ast.FunctionDef | ast.AsyncFunctionDef) -> list[ast.stmt]:
    return function.body[1:] if ast.get_docstring(function, clean=False) is not None else function.body


def _small_used_once(sources: list[Source]) -> int:
    """Undecorated functions of few lines whose name is said once beside their own definition."""
    said: Counter[str] = Counter()
    for source in sources:
        for node in ast.walk(source.tree):
            if isinstance(node, ast.Name):
                said[node.id] += 1
            elif isinstance(node, ast.Attribute):
                said[node.attr] += 1
    small = (
        one.name
        for source in sources
        for one in source.functions()
        if (body := _body(one)) and not one.decorator_list
        if (body[-1].end_lineno or 0) - body[0].lineno < FEW
    )
    return sum(said[name] == 1 for name in small)


def _parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    return len([*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs])


def _late_imports(source: Source, houses: set[str]) -> int:
    """Imports of the house's own modules inside functions."""
    found = {
        node
        for one in source.functions()
        for node in ast.walk(one)
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in houses
    }
    return len(found)


def _hard(source: Source) -> int:
    from radon.complexity import cc_visit
    from radon.visitors import Function

    found = {
        (one.lineno, one.name): one.complexity
        for block in cc_visit(source.text)
        for one in (block, *getattr(block, "methods", ()))
        if isinstance(one, Function)
    }
    return sum(paths > HARD for paths in found.values())


def figures(sources: list[Source]) -> Mapping[str, int]:
    """What is watched; less of each is better."""
    houses = {source.path.parts[0] for source in sources}
    folders = Counter(source.path.parent for source in sources)
    by_name = re.compile(r"\b(?:hasattr|getattr|has_method|word_of)\(")
    return {
        "lines of code": sum(source.code for source in sources),
        "statements": sum(isinstance(node, ast.stmt) for source in sources for node in ast.walk(source.tree)),
        "Any, object, cast, type: ignore": sum(map(_loose_types, sources)),
        f"functions of {MANY} parameters or more": sum(
            _parameters(one) >= MANY for source in sources for one in source.functions()
        ),
        f"functions of more than {HARD} paths": sum(map(_hard, sources)),
        f"functions of {FEW} lines or less, used once": _small_used_once(sources),
        "late imports of our own": sum(_late_imports(source, houses) for source in sources),
        f"folders of more than {FULL} files": sum(count > FULL for count in folders.values()),
        "files": len(sources),
        "hasattr, getattr in the engine": sum(
            len(by_name.findall(source.text)) for source in sources if source.path.parts[0] == "etendue"
        ),
        "id() in the engine": sum(
            len(re.findall(r"(?<![\w.])id\(", source.text)) for source in sources if source.path.parts[0] == "etendue"
        ),
        "lines of the longest file": max(len(source.text.splitlines()) for source in sources),
    }


def by_folder(sources: list[Source]) -> Iterator[str]:
    yield f"{'folder':34} files   code  longest"
    folders: dict[Path, list[Source]] = {}
    for source in sources:
        folders.setdefault(source.path.parent, []).append(source)
    for folder, files in folders.items():
        longest = max(files, key=lambda one: one.code)
        yield f"{folder!s:34} {len(files):5} {sum(one.code for one in files):6}  {longest.path.name} {longest.code}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, default=Path(__file__).resolve().parents[1])
    parser.add_argument("--folders", action="store_true")
    parser.add_argument("--against", type=Path, help="figures recorded before")
    parser.add_argument("--write", type=Path, help="record the figures")
    given = parser.parse_args()
    src = given.root / "src"
    sources = [Source(path, src) for path in sorted(src.rglob("*.py"))]
    if given.folders:
        print("\n".join(by_folder(sources)))
    found = figures(sources)
    before = json.loads(given.against.read_text()) if given.against else {}
    for name, value in found.items():
        risen = value > before.get(name, value)
        print(f"{name:44} {value:7,}" + (f"  risen from {before[name]:,}" if risen else ""))
    if given.write:
        given.write.write_text(json.dumps(found, indent=1) + "\n")
    return int(any(value > before.get(name, value) for name, value in found.items()))


if __name__ == "__main__":
    sys.exit(main())
