"""docs/planes.md, followed to the letter."""

from __future__ import annotations

import json
import re
import runpy
import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from nimprep.cli import main
from nimprep.schema import schema_problems
from tests.fakes import depth_image, write_png
from tests.thermal import degrees, raw_thermal

PAGE = (Path(__file__).parent.parent / "docs" / "planes.md").read_text("utf-8")
SIZE = (48, 64)


def block(kind: str) -> str:
    """Return the page's one block of a kind."""
    [found] = re.findall(rf"^```{kind}[^\n]*\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    return str(found)


def write_raw(root: Path) -> None:
    for number in range(6):
        name = f"{number:03d}"
        four = np.random.default_rng(number).integers(0, 256, (*SIZE, 4), dtype=np.uint8)
        (root / "images").mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(root / "images" / f"{name}.png"), four)
        write_png(root / "depth" / f"{name}.png", depth_image(number, SIZE))
        if number != 5:
            write_png(root / "thermal" / f"{name}.png", raw_thermal(number, SIZE))
        (root / "predicted").mkdir(exist_ok=True)
        np.save(root / "predicted" / f"{name}.npy", np.full(SIZE, 1.25, np.float32))


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_page_of_planes_works_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_raw(Path("raw"))
    assert schema_problems(json.loads(block("json")), "folder") == []
    Path("rgbt.json").write_text(block("json"))
    for line in block("sh").splitlines():
        done = CliRunner().invoke(main, shlex.split(line)[1:])
        assert done.exit_code == 0, done.output
    Path("planes.py").write_text(block("python"))
    found = runpy.run_path("planes.py")
    assert np.array_equal(found["thermal"], degrees(raw_thermal(0, SIZE)), equal_nan=True)
    assert found["batch"]["inputs"].shape[1:] == (4, 32, 32)
    store = found["store"]
    assert np.isnan(store[5]["thermal"]).all()
    assert (store[2]["predicted"] == np.float32(1.25)).all()
    four = cv2.imread("raw/images/003.png", cv2.IMREAD_UNCHANGED)
    assert four is not None
    assert np.array_equal(store[3]["infrared"], four[..., 3])
