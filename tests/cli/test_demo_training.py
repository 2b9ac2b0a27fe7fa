"""nimprep demo --train goes from nothing to the scores of a trained network."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from nimprep.cli import main
from nimprep.cli.demo_training import OPTIONS
from nimprep.evaluation import evaluate_predictions
from nimprep.networks import load_run
from nimprep.store.reader import open_store


def test_demo_trains_predicts_and_evaluates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert (OPTIONS["network"], OPTIONS["setup"]) == ("mfnet", "nim-rgb+d")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("nimprep.cli.synth.FRAMES", 8)
    monkeypatch.setattr("nimprep.cli.synth.SIZE", (64, 80))
    monkeypatch.setitem(OPTIONS, "epochs", 1)
    monkeypatch.setitem(OPTIONS, "width", 0.0625)
    told = CliRunner().invoke(main, ["demo", "--train"])
    assert told.exit_code == 0, told.output
    for command in ("train", "predict", "evaluate"):
        assert f"$ nimprep {command} " in told.stdout
    folder = tmp_path / "nimprep-demo"
    store = open_store(folder / "demo.zarr")
    assert len(store) == 8
    assert load_run(folder / "run").checkpoint.network == "mfnet"
    scores = json.loads((folder / "evaluation.json").read_text())
    found = evaluate_predictions(store, folder / "predictions", "test")
    assert scores == json.loads(json.dumps(found.to_dict()))
