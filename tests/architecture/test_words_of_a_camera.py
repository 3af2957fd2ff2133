"""The engine holds no word of a camera, and knows neither of the houses behind it.

``MOST`` and ``MENTIONS`` may only fall: who takes words out writes what is left. Both end at 0.
"""

import ast
import re
from collections import Counter
from pathlib import Path

ENGINE = Path(__file__).parents[2] / "src" / "etendue"
HOUSES = ("etendue_camera", "etendue_lab")
WORDS = re.compile(
    r"camera|sensor|(?<![a-z])lens(?![a-z])|lenses|mosaic|bayer|aperture|f_number|integration_time|photon|electron|irradiance|radiance|illuminant"
    r"|spectr|wavelength|(?<![a-z])mtf|(?<![a-z])snr|\bDN\b|\bISO\b|shot.noise|read.noise|dark.current|dsnu|prnu|(?<![a-z])emva",
    re.I,
)
MOST = 0  # lines
MENTIONS = 0  # of the other houses, in names, texts and comments


def texts():
    """Everything that is installed of the engine as text, by its path."""
    for path in sorted(ENGINE.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            try:
                yield path, path.read_text(encoding="utf-8")
            except UnicodeDecodeError:
                continue


def lines_with(pattern):
    return [
        f"{path.relative_to(ENGINE)}:{n}"
        for path, text in texts()
        for n, line in enumerate(text.splitlines(), 1)
        if pattern.search(line)
    ]


def test_words_of_a_camera_only_become_fewer():
    found = lines_with(WORDS)
    assert len(found) <= MOST, Counter(one.partition(":")[0] for one in found).most_common()


def test_no_file_has_such_a_name():
    assert [str(path) for path, _ in texts() if WORDS.search(str(path.relative_to(ENGINE)))] == []


def test_the_engine_imports_neither_of_the_other_houses():
    """Not for types either, which import-linter leaves out."""
    found = []
    for path, text in texts():
        if path.suffix == ".py":
            for node in ast.walk(ast.parse(text)):
                names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
                names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
                found += [f"{path.relative_to(ENGINE)}: {name}" for name in names if name.split(".")[0] in HOUSES]
    assert found == []


def test_the_engine_names_neither_of_the_other_houses():
    found = lines_with(re.compile("|".join(HOUSES)))
    assert len(found) <= MENTIONS, found
