"""Two processes train one network, as torchrun starts them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import nimprep.torch
from nimprep.cli import main
from nimprep.errors import LayoutError
from nimprep.training import train
from tests.processes import PATIENCE_S, Processes, same_code
from tests.training.stores import SMALL, log_lines, same_tensors, weights

OPTIONS: dict[str, Any] = {**SMALL, "network": "mfnet", "setup": "rgb+d", "batch": 1, "epochs": 2}

PROGRAM = """
import json, sys, warnings

import torch
torch.set_num_threads(1)
from nimprep.training import train
from nimprep.training.loop import Loop

store, out, options = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
ids = []
step = Loop._step

def seen(self, batch):
    ids.extend(batch["id"])
    step(self, batch)
    if len(sys.argv) > 4 and self.state.step == int(sys.argv[4]):
        raise SystemExit(3)

Loop._step = seen
try:
    done = train(store, out, **options)
finally:
    print(json.dumps({"ids": ids}), flush=True)
print(json.dumps({"steps": done.steps, "best": done.best}))
"""


def both(
    processes: Processes, meeting: Path, store: Path, out: Path, *more: int
) -> list[tuple[int, list[dict[str, Any]]]]:
    """Run the program in two processes and return their exit codes and what they printed."""
    started = []
    for rank in range(2):
        env = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": 2, "MASTER_ADDR": "127.0.0.1"}
        env |= {"TORCHELASTIC_USE_AGENT_STORE": "False", "MASTER_PORT": meeting.read_text()}
        command = [sys.executable, "-c", PROGRAM, store, out, json.dumps(OPTIONS), *more]
        started.append(
            processes.start(
                command,
                stdout=-1,
                stderr=-1,
                text=True,
                env={**same_code(), **{k: str(v) for k, v in env.items()}},
            )
        )
    said = [process.communicate(timeout=PATIENCE_S) for process in started]
    codes = [process.returncode for process in started]
    assert set(codes) <= {0, 3}, said
    return [
        (code, [json.loads(line) for line in out.splitlines()])
        for code, (out, _) in zip(codes, said, strict=True)
    ]


@pytest.fixture
def meeting(tmp_path: Path) -> Path:
    """Return a file with the number of a port that was free."""
    import socket

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        (tmp_path / "port").write_text(str(free.getsockname()[1]))
    return tmp_path / "port"


def test_two_processes_share_frames_write_once_and_go_on(
    store: Path, tmp_path: Path, processes: Processes, meeting: Path
) -> None:
    (first, one), (second, other) = both(processes, meeting, store, tmp_path / "run")
    assert (first, second) == (0, 0)
    every = set(nimprep.torch.StoreDataset(store, "train", "rgb").ids)
    assert len(every) == 4
    for epoch in range(2):
        part = slice(2 * epoch, 2 * epoch + 2)
        assert {*one[0]["ids"][part], *other[0]["ids"][part]} == every
    assert one[1] == other[1]
    assert one[1]["steps"] == 4
    lines = log_lines(tmp_path / "run")
    assert [line["step"] for line in lines] == [2, 4]
    with pytest.raises(LayoutError, match=r"expected 2 processes, with which .* found 1; start as"):
        train(store, tmp_path / "run", **OPTIONS)
    # Left in the middle of the second epoch: the end of the first is kept.
    cut = both(processes, meeting, store, tmp_path / "cut", 3)
    assert [code for code, _ in cut] == [3, 3]
    again = both(processes, meeting, store, tmp_path / "cut")
    assert [code for code, _ in again] == [0, 0]
    assert [said[0]["ids"] for _, said in again] == [one[0]["ids"][2:], other[0]["ids"][2:]]
    assert same_tensors(weights(tmp_path / "run"), weights(tmp_path / "cut"))
    assert log_lines(tmp_path / "cut") == lines


@pytest.mark.parametrize("rank", ["0", "1"])
def test_the_first_process_alone_prints_the_result(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rank: str
) -> None:
    monkeypatch.setenv("RANK", rank)
    call = ["train", str(store), "--out", str(tmp_path / "run"), "-q", "--network", "mfnet"]
    call += ["--setup", "rgb+d", "--width", "0.03", "--epochs", "1", "--threads", "1"]
    told = CliRunner().invoke(main, call)
    assert told.exit_code == 0, told.output
    assert ("best.pt: epoch 1" in told.stdout) == (rank == "0")
