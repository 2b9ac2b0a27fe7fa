"""What pages say of the project is there: the files they link to, and the house as it is."""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import torch
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from tests.fakes import write_gmrp
from tests.kitti.scenes import write_whole_benchmark
from tests.test_layers import LAYERS
from tests.training.runs import make_run

ROOT = Path(__file__).parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("schemas/*.md")])
LINK = re.compile(r"\]\((?!https?://|#)([^)#]+)(#[^)]*)?\)")


def test_there_are_pages() -> None:
    names = {page.name for page in PAGES}
    assert {"README.md", "CONTRIBUTING.md", "CHANGELOG.md", "architecture.md"} <= names


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_a_file(page: Path) -> None:
    links = [match[1] for match in LINK.finditer(page.read_text())]
    assert [link for link in links if not (page.parent / link).exists()] == []


def test_the_house_is_drawn_as_it_is() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text()
    table = page[page.index("| floor |") : page.index("A folder has one job")]
    rows = [re.findall(r"`(\w+)`", row.split("|")[1]) for row in table.splitlines()[2:] if row]
    assert rows == [row for row in LAYERS if row != ["__main__"]]


def test_the_way_through_convert_is_at_most_eight_files() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text()
    way = page[page.index("## What happens in convert") : page.index("`append` takes")]
    assert len(re.findall(r"^\d\. \[", way, re.M)) == 8


def test_the_readmes_training_loop_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (ROOT / "README.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page[page.index("## Train") :], re.S)[:1]
    raw = write_gmrp(tmp_path / "gmrp", frames=6, size=(64, 96))
    nimprep.convert(raw, tmp_path / "gmrp.zarr", camera=(60, 60, 47.5, 31.5))
    monkeypatch.chdir(tmp_path)
    for written, small in (
        ("range(40)", "range(2)"),
        ("480, 640", "64, 64"),
        ("batch_size=4", "batch_size=2"),
    ):
        assert written in code
        code = code.replace(written, small)
    torch.manual_seed(0)
    found: dict[str, Any] = {}
    exec(code, found)
    assert found["batch"]["inputs"][1].shape == (2, 3, 64, 64)
    assert all(p.isfinite().all() for p in found["network"].parameters())


def test_the_readmes_way_from_kittis_folder_to_the_zip_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (ROOT / "README.md").read_text()
    page = page[page.index("## KITTI road") : page.index("## Measured")]
    blocks = re.findall(r"```(sh|python)\n(.*?)```", page, re.S)
    assert [kind for kind, _ in blocks] == ["sh", "sh", "sh"]
    write_whole_benchmark(tmp_path / "data_road", parts=("image_2", "calib", "depth_u16"))
    monkeypatch.chdir(tmp_path)
    # Its frames here are so small that none could be trained on.
    monkeypatch.setattr("nimprep.training.data.SMALLEST", 1)
    printed = []
    for line in "".join(code for _, code in blocks).splitlines():
        command, *arguments = shlex.split(line, comments=True)
        if arguments[:1] == ["train"]:
            options = dict(zip(arguments[2::2], arguments[3::2], strict=True))
            assert options["--crop"] == "352,1216"
            make_run(Path("road.zarr"), Path("run"), options["--network"], options["--setup"])
        elif command == "nimprep":
            done = CliRunner().invoke(main, arguments)
            assert (done.exit_code, done.stderr) == (0, ""), line
            printed += [] if arguments[0] == "predict" else [done.stdout]
    assert len(printed) == 3
    assert re.search(r"train 253, val 36, test 290", printed[0])
    # All tables of the frames held out, and the whole test set.
    rows = [line.split() for line in printed[1].splitlines()[1:]]
    assert {row[0]: int(row[-1]) for row in rows} == {
        "um_road": 12,
        "umm_road": 12,
        "uu_road": 12,
        "urban": 36,
    }
    assert "submission.zip: 290 predictions, 290 of them transformed" in printed[2]
