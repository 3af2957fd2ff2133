"""Ways in which a distribution lays out the code of a stage: ``layouts.txt``, read and written to a folder of the
path.
"""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass, field
from pathlib import Path

STAGE = """
from dataclasses import dataclass
from etendue.api import Stage

@dataclass(frozen=True, kw_only=True)
class Added({base}):
    reads = {{"rgb_camera": "channel y x [1]"}}
    writes = {{"rgb_camera": "channel y x [1]"}}
    nan = negative = "keep"

    def run(self, rgb_camera):
        {body}
        return {{"rgb_camera": rgb_camera + rgb_camera.dtype.type({value})}}
"""


@dataclass
class Layout:
    """``edits``: files whose edit must be seen, and the name under which it is. ``apart``: files that nothing
    reaches.
    """

    title: str
    module: str
    files: dict[str, str] = field(default_factory=dict)
    edits: dict[str, str] = field(default_factory=dict)
    apart: list[str] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=dict)  # of what is installed, by name

    def written(self, n: str, root: Path) -> None:
        """Its files, and what an installer writes beside them."""
        for path, text in self.files.items():
            if not ours(path):
                place = root / named(path, n)
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_text(named(text, n))
        for name, metadata in self.metadata.items():
            install(root, named(name, n), named(metadata, n))


def ours(path: str) -> bool:
    """Whether a file is one of the packages of this distribution."""
    return path.split("/")[0] in ("etendue", "etendue_camera", "etendue_lab")


def named(text: str, n: str) -> str:
    return text.replace("{n}", n)


def _read() -> list[Layout]:
    found: list[Layout] = []
    place, key = {}, ""
    for line in (Path(__file__).parent / "layouts.txt").read_text().splitlines():
        mark, _, rest = line.partition(" ")
        if mark == "==":
            found.append(Layout(*rest.split(": ")))
        elif mark == "++":
            place, key = found[-1].metadata, rest
            place[key] = ""
        elif mark == "--":
            place = found[-1].files
            key, _, name = rest.partition(" ")
            place[key] = ""
            if name == "-":
                found[-1].apart.append(key)
            elif name:
                found[-1].edits[key] = name
        elif mark == "STAGE":
            base, body, value = rest.split(" | ")
            place[key] += STAGE.format(base=base, body=body, value=value)
        elif found:
            place[key] += line + "\n"
    return found


LAYOUTS = {layout.title: layout for layout in _read()}


def install(root: Path, name: str, metadata: str) -> None:
    """The metadata of a distribution with a package or module of its name, as an installer writes it: the record
    last.
    """
    folder = root / f"{name}-1.0.dist-info"
    folder.mkdir(exist_ok=True)
    (folder / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n{metadata.strip()}\n\nOf requirements: etendue\n"
    )
    (folder / "INSTALLER").write_text("test\n")
    paths = (
        [root / f"{name}.py"]
        if (root / f"{name}.py").is_file()
        else sorted(p for p in (root / name).rglob("*") if p.is_file())
    )
    lines = []
    for path in paths:
        digest = base64.urlsafe_b64encode(hashlib.sha256(path.read_bytes()).digest()).rstrip(b"=").decode()
        lines.append(f"{path.relative_to(root).as_posix()},sha256={digest},{path.stat().st_size}")
    (folder / "RECORD").write_text(
        "\n".join([*lines, f"{folder.name}/METADATA,,", f"../../bin/{name},sha256=x,9", f"{folder.name}/RECORD,,"])
    )
