"""docs/add-a-modality.md, followed to the letter in a copy of the package."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.fakes import contents, write_gmrp

PROJECT = Path(__file__).parent.parent
PAGE = (PROJECT / "docs" / "add-a-modality.md").read_text("utf-8")
COPIED = (
    "nimprep",
    "schemas",
    "pyproject.toml",
    "tests/__init__.py",
    "tests/checksums.py",
    "tests/test_modality.py",
)

ABOVE = {
    "nimprep/modality.py": '        Modality(\n            name="label",',
    "schemas/store.schema.json": '        "label": {',
    "schemas/README.md": "| `label` |",
}
"""The label's entry, above which the page wants the new one, in each file that it changes."""

TRUTH = """
import json
import numpy as np
import torch
from nimprep.modality import MODALITIES
from nimprep.torch import Normalize

frame = store[1]
v, u = np.indices(frame.depth_m.shape)
x, y = (u - frame.camera.cx) / frame.camera.fx, (v - frame.camera.cy) / frame.camera.fy
exact = np.linalg.norm(np.stack([x, y, np.ones_like(x)]) * frame.depth_m, axis=0)
found = frame.image("distance")
assert found.dtype == np.float32
assert np.array_equal(found > 0, frame.depth_m > 0) and (found > 0).any()
assert np.abs(found - exact).max() <= 0.0011
archive = np.load(next(iter(sorted(__import__("pathlib").Path("arrays").rglob("*.npz")))))
assert np.array_equal(archive["distance"], distance)

assert batch["distance"].shape[1:] == (1, 32, 64)
network = torch.nn.Conv2d(4, len(store.classes), 3, padding=1)
scores = network(torch.cat([batch["rgb"], batch["distance"]], dim=1))
torch.nn.functional.cross_entropy(scores, batch["label"], ignore_index=255).backward()
assert network.weight.grad[:, 3].abs().max() > 0

plain = StoreDataset("streets.zarr", None, modalities=("distance",))
stored = StoreDataset("streets.zarr", None, modalities=("distance",), dtype="stored")
assert torch.allclose(plain[1]["distance"][0], torch.from_numpy(found) / 10)
assert torch.allclose(Normalize(stored)(stored[1])["distance"], plain[1]["distance"])
"""


class Block(NamedTuple):
    language: str
    file: str
    text: str


def blocks() -> list[Block]:
    found = re.findall(r'^```(\w+)(?: title="(.+?)")?\n(.*?)^```$', PAGE, re.MULTILINE | re.DOTALL)
    return [Block(*block) for block in found]


def follow(copy: Path, *, without: str = "") -> Path:
    """Copy the package and write the page's blocks into it, all but one."""
    for name in COPIED:
        source, target = PROJECT / name, copy / name
        target.parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if source.is_dir() else shutil.copy2)(source, target)
    for block in blocks():
        path = copy / block.file
        if "/" not in block.file or block.file == without:
            continue
        if block.file not in ABOVE:
            assert not path.exists()
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, "utf-8")
            continue
        text, place = path.read_text("utf-8"), ABOVE[block.file]
        assert text.count(place) == 1
        entry = block.text.rstrip() + (",\n" if path.suffix == ".py" else "\n")
        indent = " " * (len(place) - len(place.lstrip()))
        path.write_text(text.replace(place, textwrap.indent(entry, indent) + place), "utf-8")
    return copy


def python(copy: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return follow(tmp_path_factory.mktemp("copy"))


@pytest.fixture(scope="module")
def said(copy: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Run the page's commands, in order, in a folder of their own; return what each printed."""
    folder = tmp_path_factory.mktemp("commands")
    said = {"folder": str(folder)}
    (shell,) = (block.text for block in blocks() if block.language == "sh")
    for line in shell.splitlines():
        program, command, *arguments = shlex.split(line)
        assert program == "nimprep"
        done = python(copy, folder, "-m", "nimprep", command, *arguments)
        assert done.returncode == 0, done.stderr
        said[command] = done.stdout
    return said


def test_the_example_touches_the_four_files_that_the_page_names_and_a_test() -> None:
    named = re.findall(r"^\| `(.+?)` \|", PAGE.partition("## 1.")[0], re.MULTILINE)
    written = [block.file for block in blocks() if "/" in block.file]
    assert written == named
    assert len([name for name in named if not name.startswith("tests/")]) == 4
    assert set(ABOVE) < set(named)


def test_schema_page_record_and_the_functions_own_test_agree(copy: Path) -> None:
    tests = ("tests/test_modality.py", "tests/derive/test_distance.py")
    done = python(copy, copy, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests)
    assert done.returncode == 0, done.stdout
    assert "distance" in python(copy, copy, "-m", "pytest", "-q", "--co", tests[0]).stdout


def test_commands_make_describe_check_and_show_it(said: dict[str, str]) -> None:
    assert re.search(r"^distance +uint16 +distance ", said["info"], re.MULTILINE)
    assert "frames recomputed" in said["validate"]
    page = (Path(said["folder"]) / "report.html").read_text("utf-8")
    assert "centre, near is yellow, far is dark, grey has none" in page
    assert 'id="legend-distance"' in page
    assert page.count('"distance": "') >= 6


def test_python_reads_it_and_a_network_learns_from_it(copy: Path, said: dict[str, str]) -> None:
    (code,) = (block.text for block in blocks() if block.file == "train.py")
    done = python(copy, Path(said["folder"]), "-W", "error", "-c", code + TRUTH)
    assert done.returncode == 0, done.stderr


def test_a_changed_pixel_of_it_is_found(copy: Path, said: dict[str, str], tmp_path: Path) -> None:
    store = Path(shutil.copytree(Path(said["folder"]) / "streets.zarr", tmp_path / "s.zarr"))
    code = (
        "import zarr\nfrom pathlib import Path\nfrom tests.checksums import renew_checksums\n"
        "zarr.open_group('s.zarr', mode='r+')['distance'][0, 60, 40] += 9\n"
        "renew_checksums(Path('s.zarr'))\n"
    )
    done = python(copy, tmp_path, "-c", code)
    assert done.returncode == 0, done.stderr
    done = python(copy, tmp_path, "-m", "nimprep", "validate", str(store), "--deep")
    assert done.returncode == 1
    assert "distance: expected what 'distance' makes of the depth, found 1 pixels" in done.stdout


def test_without_its_schema_it_is_refused_before_a_conversion_begins(tmp_path: Path) -> None:
    copy = follow(tmp_path / "copy", without="schemas/store.schema.json")
    folder = tmp_path / "work"
    write_gmrp(folder / "raw")
    before = contents(folder)
    names = ("--modalities", "rgb,depth,distance")
    done = python(copy, folder, "-m", "nimprep", "convert", "raw", "out.zarr", *names)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "store.schema.json: expected it to describe distance, found only rgb, " in done.stderr
    assert contents(folder) == before
