"""The house in figures: files, lines and words by folder; two outputs, of two commits, side by side say what grew.

    python benchmarks/house.py [--root .]

Code lines are those that are neither blank, comment nor docstring.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import tokenize
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


def code_lines(text: str) -> int:
    """Lines with code on them."""
    tree = ast.parse(text)
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--root", type=Path, default=Path(__file__).resolve().parents[1])
    package = parser.parse_args().root / "src"
    texts = {path.relative_to(package): path.read_text() for path in sorted(package.rglob("*.py"))}
    lines = {path: code_lines(text) for path, text in texts.items()}
    print(f"{'folder':30} files  lines  code  longest")
    folders: dict[str, list[Path]] = {}
    for path in texts:
        folders.setdefault("/".join(path.parts[:-1]) or ".", []).append(path)
    for folder, paths in folders.items():
        longest = max(paths, key=lambda path: len(texts[path].splitlines()))
        whole = sum(len(texts[path].splitlines()) for path in paths)
        print(
            f"{folder:30} {len(paths):5} {whole:6} {sum(lines[p] for p in paths):5}  {longest.name} "
            f"{len(texts[longest].splitlines())}"
        )
    print(f"{'all':30} {len(texts):5} {sum(len(t.splitlines()) for t in texts.values()):6} {sum(lines.values()):5}")
    for house in sorted({path.parts[0] for path in texts}):
        own = [path for path in texts if path.parts[0] == house]
        code, statements = (
            sum(lines[p] for p in own),
            sum(isinstance(n, ast.stmt) for p in own for n in ast.walk(ast.parse(texts[p]))),
        )
        print(f"{house}: {len(own)} files, {code} lines of code, {statements} statements")
    by_name = re.compile(r"\b(?:hasattr|getattr|has_method|word_of)\(")
    print(
        "hasattr, getattr in the engine:",
        sum(len(by_name.findall(text)) for path, text in texts.items() if path.parts[0] == "etendue"),
    )
    print("Any:", sum(len(re.findall(r"\bAny\b", text)) for text in texts.values()))
    print(
        "longest:",
        ", ".join(
            f"{path} {len(text.splitlines())}"
            for path, text in sorted(texts.items(), key=lambda one: -one[1].count("\n"))[:4]
        ),
    )


if __name__ == "__main__":
    main()
