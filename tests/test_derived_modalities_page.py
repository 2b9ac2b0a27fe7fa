"""docs/derived-modalities.md, followed to the letter."""

from __future__ import annotations

import re
import runpy
import shlex
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner

from nimprep.cli import main
from nimprep.modality import MODALITIES
from nimprep.torch import StoreDataset
from tests.fakes import write_gmrp

PAGE = (Path(__file__).parent.parent / "docs" / "derived-modalities.md").read_text("utf-8")


def blocks(kind: str) -> list[str]:
    """Return the page's blocks of a kind."""
    return re.findall(rf"^```{kind}[^\n]*\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_page_works_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_gmrp(Path("gmrp"), frames=6, size=(48, 64))
    for line in blocks("sh")[0].splitlines():
        done = CliRunner().invoke(main, shlex.split(line, comments=True)[1:])
        assert done.exit_code == 0, done.output
    features, separation = blocks("python")
    Path("features.py").write_text(features)
    found = runpy.run_path("features.py")
    assert found["both"][0]["inputs"].shape[0] == 4
    assert [len(part) for part in found["pair"][0]["inputs"]] == [3, 4]
    assert found["pair"].scaling.cut["elevation"] == (-0.5, 2.5)
    assert "elevation cut to -0.5 to 2.5 m" in repr(found["pair"])
    assert set(torch.unique(found["each"][0]["mask"]).tolist()) <= {0.0, 1.0}
    Path("separation.py").write_text(separation.replace('"report.html"', '"again.html"'))
    runpy.run_path("separation.py")
    assert "Elevation" in capsys.readouterr().out


def test_the_page_has_every_derived_modality_with_its_numbers() -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \|(.*)$", PAGE, re.MULTILINE))
    derived = {name: m for name, m in MODALITIES.items() if m.derived is not None}
    assert set(rows) == set(derived)
    for name, modality in derived.items():
        assert modality.dtype in rows[name]
        if modality.values != "vectors":
            assert f"divided by {modality.divisor:g}" in rows[name]
        if modality.cut is not None:
            low, high = modality.cut
            assert f"cut to \N{MINUS SIGN}{-low:g} to {high:g}" in rows[name]


def test_tensors_stay_within_what_the_page_says(tmp_path: Path) -> None:
    write_gmrp(tmp_path / "gmrp", frames=2)
    target = tmp_path / "a.zarr"
    options = ["--modalities", "elevation", "--intrinsics", "30,31,15,11"]
    done = CliRunner().invoke(main, ["convert", str(tmp_path / "gmrp"), str(target), *options])
    assert done.exit_code == 0, done.output
    found = StoreDataset(target, None, modalities=("elevation",))[0]["elevation"]
    assert -2 <= float(found.min()) < float(found.max()) <= 2
