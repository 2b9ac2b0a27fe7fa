"""What is kept, and said, where val or train tell less than a person might think."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import StoreError
from nimprep.training import train
from nimprep.training.data import frame_size
from tests.fakes import write_gmrp, write_png
from tests.training.stores import CAMERA, SMALL, log_lines

OPTIONS: dict[str, Any] = {**SMALL, "network": "mfnet", "setup": "rgb+d", "batch": 4}


@pytest.mark.parametrize(
    ("scores", "kept"),
    [
        ([None, None, None], [True, True, True]),
        ([None, 0.2, None, 0.1, 0.2, 0.3], [True, True, False, False, False, True]),
        ([0.0, 0.0, None], [True, False, False]),
    ],
)
def test_where_val_has_no_score_the_last_weights_are_kept(
    store: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    scores: list[float | None],
    kept: list[bool],
) -> None:
    left = iter(scores)
    monkeypatch.setattr("nimprep.training.loop.figures", lambda found: {"f_score": next(left)})
    done = train(store, tmp_path / "run", **OPTIONS, epochs=len(scores))
    lines = [line for line in log_lines(tmp_path / "run") if "epoch" in line]
    assert [line["best"] for line in lines] == kept
    assert done.best["epoch"] == 1 + max(place for place, best in enumerate(kept) if best)


def test_classes_without_a_pixel_are_said_and_one_class_is_refused(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "raw", 4, (64, 64))
    for file in (raw / "label").iterdir():
        write_png(file, np.zeros((64, 64), np.uint8))
    place = nimprep.convert(raw, tmp_path / "s.zarr", camera=CAMERA, modalities=("rgb", "label"))
    call = ["train", str(place.path), "--out", str(tmp_path / "run"), "-q", "--network", "unet"]
    call += ["--setup", "rgb", "--width", "0.03", "--epochs", "1", "--threads", "1"]
    told = CliRunner().invoke(main, call)
    assert told.exit_code == 0, told.output
    for split in ("train", "val"):
        assert told.stderr.count(f"no pixels of drivable area, road anomaly in {split};") == 1
    one: Any = SimpleNamespace(
        path="s.zarr", classes=place.classes[:1], modalities=place.modalities
    )
    with pytest.raises(StoreError, match="expected two classes or more, found 'background' alone"):
        frame_size(one)
