"""Modalities that a store could hold, and that nobody could open it with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import StoreError
from nimprep.modality import MODALITIES
from tests.fakes import contents, write_gmrp

CAMERA = (30.0, 31.0, 15.0, 11.0)


CASES = {
    "unknown": ({"name": "height"}, ("rgb", "height"), "describe height"),
    "unknown, by default": ({"name": "height", "on_request": False}, None, "describe height"),
    "described otherwise": ({"name": "disparity"}, ("disparity",), "virtual_baseline_m"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_modality_unlike_the_attributes_schema_is_refused_before_anything_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    raw = write_gmrp(tmp_path / "raw")
    before = contents(tmp_path)
    changes, names, found = CASES[case]
    # Made and described as elevation is.
    modality = replace(MODALITIES["elevation"], **changes)
    monkeypatch.setitem(MODALITIES, modality.name, modality)
    reads: list[str] = []
    monkeypatch.setattr("nimprep.readers.folder.raw_depth", lambda *a, **k: reads.append("read"))
    with pytest.raises(StoreError, match=rf"store.schema.json: .*{found}.*; describe"):
        nimprep.convert(raw, tmp_path / "s.zarr", camera=CAMERA, modalities=names, crop="auto")
    options = [] if names is None else ["--modalities", ",".join(names)]
    arguments = ["convert", str(raw), str(tmp_path / "s.zarr"), "--crop", "auto", *options]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 1
    assert done.stderr.count("\n") == 1
    assert found in done.stderr
    assert contents(tmp_path) == before
    assert {path.name for path in tmp_path.iterdir()} == {"raw"}
    assert reads == []
