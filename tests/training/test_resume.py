"""A run that was cut short goes on as if nothing had happened."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from nimprep.training import train
from tests.processes import PATIENCE_S, Processes, same_code
from tests.training.killed import KILLS, OPTIONS
from tests.training.stores import SMALL, log_lines, same_tensors, weights


def test_a_run_killed_ten_times_ends_with_the_same_weights(
    store: Path, tmp_path: Path, processes: Processes
) -> None:
    assert len(KILLS) == 10
    trained = processes.start(
        [sys.executable, "-m", "tests.training.killed", store, tmp_path],
        stdout=-1,
        stderr=-1,
        text=True,
        env=same_code(),
    )
    out, err = trained.communicate(timeout=PATIENCE_S)
    assert out.split() == ["0", *["-9"] * 10, "0"], err
    one, other = tmp_path / "undisturbed", tmp_path / "killed"
    for name in ("last.pt", "best.pt"):
        assert same_tensors(weights(one, name), weights(other, name))
    assert log_lines(one) == log_lines(other)
    assert len(log_lines(one)) == 6 + 6 * 4
    left = [
        {k: v for k, v in torch.load(run / "last.pt", weights_only=True).items() if k != "log"}
        for run in (one, other)
    ]
    assert str(left[0]) == str(left[1])
    assert (one / "config.toml").read_text() == (other / "config.toml").read_text()
    assert {p.name for p in other.iterdir() if not p.name.startswith(".")} == {
        "best.pt",
        "config.toml",
        "last.pt",
        "log.jsonl",
    }


def test_other_seeds_end_with_other_weights(store: Path, tmp_path: Path) -> None:
    few: dict[str, Any] = {**OPTIONS, "epochs": 1}
    for seed in (0, 1, 0):
        train(store, tmp_path / f"{seed}-{len(list(tmp_path.iterdir()))}", **few, seed=seed)
    first, other, again = (weights(run) for run in sorted(tmp_path.iterdir(), key=_number))
    assert same_tensors(first, again)
    assert not same_tensors(first, other)


def _number(run: Path) -> str:
    return run.name.partition("-")[2]


def test_the_callers_random_numbers_stay_theirs(store: Path, tmp_path: Path) -> None:
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    train(store, tmp_path / "run", **{**OPTIONS, "epochs": 1})
    assert torch.equal(torch.rand(3), expected)


COMMAND = [
    *("--network", "mfnet", "--setup", "rgb+d", "--width", 0.125, "--batch", 1, "--epochs", 4),
    *("--checkpoint-steps", 1, "--threads", 1),
]


def test_the_command_goes_on_after_a_kill_and_after_ctrl_c(
    store: Path, tmp_path: Path, processes: Processes
) -> None:
    out = tmp_path / "run"

    def start() -> Any:
        return processes.start(
            [sys.executable, "-m", "nimprep", "train", store, "--out", out, *COMMAND],
            stdout=-1,
            stderr=-1,
            text=True,
            env={**same_code(), "OMP_NUM_THREADS": "1"},
        )

    first = start()
    assert first.stderr.readline().startswith("epoch 1: loss ")
    os.kill(first.pid, signal.SIGKILL)
    assert first.wait() == -signal.SIGKILL
    second = start()
    said = second.stderr.readline()
    assert said.startswith("going on at step ")
    while not said.startswith("epoch"):
        said = second.stderr.readline()
    os.kill(second.pid, signal.SIGINT)
    rest = second.communicate(timeout=PATIENCE_S)
    if second.returncode:
        # Or it had ended before it heard.
        assert second.returncode == 130
        assert f"interrupted; {out} holds step" in rest[1]
    third = start()
    told, errors = third.communicate(timeout=PATIENCE_S)
    assert third.returncode == 0, errors
    assert told.startswith(f"{out}: 16 steps, 4 epochs\nbest.pt: epoch ")
    options: dict[str, Any] = {**SMALL, "network": "mfnet", "setup": "rgb+d", "batch": 1}
    train(store, tmp_path / "whole", **options, epochs=4)
    assert same_tensors(weights(out), weights(tmp_path / "whole"))
    assert same_tensors(weights(out, "best.pt"), weights(tmp_path / "whole", "best.pt"))


@pytest.mark.parametrize("place", ["a step", "val", "an epoch's last step"])
def test_ctrl_c_keeps_the_step_that_it_came_in(store: Path, tmp_path: Path, place: str) -> None:
    options: dict[str, Any] = {**OPTIONS, "epochs": 2, "checkpoint_steps": None}
    train(store, tmp_path / "whole", **options)
    wanted = {"a step": 2, "val": 4, "an epoch's last step": 4}[place]

    class Interrupting:
        """Press Ctrl-C as a step ends."""

        def begin(self, done: int, steps: int) -> None:
            assert (done, steps) == (0, 8)

        def step(self, number: int, loss: float) -> None:
            if number == wanted and place != "val":
                os.kill(os.getpid(), signal.SIGINT)

        def epoch(self, line: Any, seconds_left: float) -> None:
            raise AssertionError("expected it to end before")

        def say(self, text: str) -> None: ...

        def end(self) -> None: ...

    with pytest.MonkeyPatch.context() as patch:
        if place == "val":
            _press_while_scoring(patch)
        with pytest.raises(KeyboardInterrupt) as raised:
            train(store, tmp_path / "run", watcher=Interrupting(), **options)
    assert raised.value.__notes__ == [
        f"{tmp_path / 'run'} holds step {wanted}; the same command goes on"
    ]
    assert torch.load(tmp_path / "run" / "last.pt", weights_only=True)["step"] == wanted
    train(store, tmp_path / "run", **options)
    assert same_tensors(weights(tmp_path / "run"), weights(tmp_path / "whole"))
    assert log_lines(tmp_path / "run") == log_lines(tmp_path / "whole")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def _press_while_scoring(patch: pytest.MonkeyPatch) -> None:
    import nimprep.training.scoring as scoring

    confusion_matrix = scoring.confusion_matrix

    def pressed(*arguments: Any) -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        return confusion_matrix(*arguments)

    patch.setattr(scoring, "confusion_matrix", pressed)
