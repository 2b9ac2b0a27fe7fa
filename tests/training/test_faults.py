"""What ends a training is one line that says what to change, and exit code 1."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import torch
from click.testing import CliRunner

import nimprep.training.loop as loop
import nimprep.training.scoring as scoring
from nimprep.cli import main
from nimprep.errors import TrainingError
from nimprep.training import train
from nimprep.training.criterion import Criterion
from nimprep.training.precision import Precision
from tests.training.stores import SMALL

CALL = ["--network", "mfnet", "--setup", "rgb+d", "--width", "0.125", "--threads", "1"]


def told(store: Path, out: Path, *more: str) -> str:
    """Return the one line that the command ends in."""
    result = CliRunner().invoke(main, ["train", str(store), "--out", str(out), "-q", *CALL, *more])
    assert result.exit_code == 1, result.output
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("error: ")
    return result.stderr


GPU = torch.OutOfMemoryError(
    "CUDA out of memory. Tried to allocate 20.00 GiB.\nGPU 0 has a total capacity of 4 GiB"
)
CPU = RuntimeError("[enforce fail at alloc_cpu.cpp] DefaultCPUAllocator: can't allocate memory: x")


@pytest.mark.parametrize("error", [GPU, CPU])
def test_no_memory_for_a_step(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    steps = 0
    step = Precision.step

    def full(*arguments: Any) -> None:
        nonlocal steps
        steps += 1
        if steps == 2:
            raise error
        step(*arguments)

    monkeypatch.setattr(Precision, "step", full)
    few = ("--batch", "2", "--epochs", "2", "--checkpoint-steps", "1")
    line = told(store, tmp_path / "run", *few)
    assert line == (
        "error: cpu: expected memory for mfnet on a batch of 2, 64x64, found none left; give a "
        "smaller --batch (now 2), a smaller --crop, a smaller --width (now 0.125) or --amp on, and "
        "another --out\n"
    )
    monkeypatch.undo()
    # What came before is kept.
    assert torch.load(tmp_path / "run" / "last.pt", weights_only=True)["step"] == 1
    again = train(store, tmp_path / "run", network="mfnet", setup="rgb+d", **SMALL, epochs=2)
    assert again.steps == 4


def test_no_memory_for_whole_frames(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise GPU

    monkeypatch.setattr(scoring, "confusion_matrix", full)
    line = told(store, tmp_path / "run")
    assert "cpu: expected memory for a whole frame of val, found none left; give a smaller " in line


def test_another_fault_keeps_its_traceback(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: Any) -> None:
        raise RuntimeError("a bug")

    monkeypatch.setattr(Precision, "step", broken)
    with pytest.raises(RuntimeError, match=r"^a bug$"):
        train(store, tmp_path / "run", network="mfnet", setup="rgb+d", **SMALL)


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_a_loss_that_is_no_number(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: float
) -> None:
    loss, calls = Criterion.loss, 0

    def ran_away(*arguments: Any) -> Any:
        nonlocal calls
        calls += 1
        return loss(*arguments) * (number if calls == 3 else 1)

    monkeypatch.setattr(Criterion, "loss", ran_away)
    line = told(store, tmp_path / "run", "--batch", "1", "--checkpoint-steps", "1")
    assert line == (
        f"error: mfnet: expected finite numbers, found a loss of {number:g} at step 3, at a "
        "learning rate of 0.01; give a lower --lr (now 0.01), --warmup 1, --clip 1 or --amp off, "
        "and another --out\n"
    )
    assert torch.load(tmp_path / "run" / "last.pt", weights_only=True)["step"] == 2


def test_weights_that_are_no_numbers_are_not_kept(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step, calls = Precision.step, 0

    def ran_away(self: Precision, loss: Any, optimizer: Any, network: Any, clip: float) -> None:
        nonlocal calls
        calls += 1
        step(self, loss, optimizer, network, clip)
        if calls == 2:
            with torch.no_grad():
                next(network.parameters())[0] = math.inf

    monkeypatch.setattr(Precision, "step", ran_away)
    line = told(store, tmp_path / "run", "--batch", "1", "--checkpoint-steps", "1")
    assert "found first.stages" in line or "that are no numbers at step 2" in line
    assert torch.load(tmp_path / "run" / "last.pt", weights_only=True)["step"] == 1


def test_a_rate_that_is_far_too_high_is_told_by_itself(store: Path, tmp_path: Path) -> None:
    options: dict[str, Any] = {**SMALL, "network": "unet", "setup": "rgb", "batch": 1}
    with pytest.raises(TrainingError, match=r"expected finite numbers, found .* at step "):
        train(store, tmp_path / "run", **options, optimizer="sgd", lr=1e30, weight_decay=1.0)
    assert loop.BEST not in {path.name for path in (tmp_path / "run").iterdir()}
