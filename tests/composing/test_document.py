"""The document on Python runs as it is printed."""

import re
from pathlib import Path

TEXT = (Path(__file__).parents[2] / "docs" / "python.md").read_text()


def test_its_blocks_run_one_behind_the_other(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    blocks = re.findall(r"```python\n(.*?)```", TEXT, flags=re.S)
    assert len(blocks) == 4
    for block in blocks:
        exec(block, names)
    assert (tmp_path / "small.toml").exists() and (tmp_path / "small" / "data.zarr").is_dir()
    assert names["outcome"].tree["demosaic"].rgb_camera.sizes["f_number"] == 3
    assert names["brightness"](2) > names["brightness"](8) > 0
