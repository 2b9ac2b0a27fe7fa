"""A run's folder is one run's, and one process's at a time."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
import torch

import nimprep
from nimprep.errors import LayoutError, NimprepError, StoreError
from nimprep.store.lock import locked_folder
from nimprep.training import train
from tests.fakes import contents
from tests.training.stores import SMALL, make_store, same_tensors, weights

OPTIONS: dict[str, Any] = {**SMALL, "network": "mfnet", "setup": "rgb+d", "epochs": 1, "batch": 4}


@pytest.fixture(scope="module")
def finished(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run of one epoch."""
    out = tmp_path_factory.mktemp("finished") / "run"
    train(store, out, **OPTIONS)
    return out


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """Return a copy of it."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


def test_a_complete_run_stays_as_it_is(store: Path, run: Path) -> None:
    before = contents(run)
    again = train(store, run, **OPTIONS)
    assert contents(run) == before
    assert (again.steps, again.best["epoch"]) == (1, 1)
    assert sorted(before) == ["best.pt", "config.toml", "last.pt", "log.jsonl"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"width": 0.25}, "width 0.125, not 0.25"),
        ({"lr": 0.5, "seed": 3}, "lr 0.01, not 0.5; seed 0, not 3"),
        (
            {"network": "fusenet", "crop": (64, 64)},
            "network mfnet, not fusenet; lr 0.01, not 0.005; .*gamma 0.95, not 0.9",
        ),
        ({"setup": ("rgb", "normal")}, r"setup rgb\+d, not rgb,normal"),
        ({"epochs": 2}, "epochs 1, not 2"),
        ({"scale": (0.5, 2.0)}, "scale none, not 0.5,2"),
    ],
)
def test_other_options_are_named(store: Path, run: Path, change: dict[str, Any], said: str) -> None:
    before = contents(run)
    with pytest.raises(LayoutError, match=f"found others: {said}; give the same to go on"):
        train(store, run, **{**OPTIONS, **change})
    (run / "last.pt").unlink()
    before.pop("last.pt")
    with pytest.raises(LayoutError, match=f"found others: {said}; give the same to go on"):
        train(store, run, **{**OPTIONS, **change})
    assert contents(run) == before


def test_what_does_not_tell_may_be_another(store: Path, run: Path) -> None:
    before = contents(run)
    train(store, run, **{**OPTIONS, "threads": 2, "log_steps": 1, "checkpoint_steps": 7})
    assert contents(run) == before


def test_another_store_is_refused_and_a_moved_one_is_not(
    store: Path, run: Path, tmp_path: Path
) -> None:
    moved = Path(shutil.copytree(store, tmp_path / "moved.zarr"))
    assert train(moved, run, **OPTIONS).steps == 1
    other = make_store(tmp_path / "other", 9)
    split = make_store(tmp_path / "split", seed=5)
    for place in (other, split):
        with pytest.raises(LayoutError, match="expected the store that its run was begun with"):
            train(place, run, **OPTIONS)


def test_a_run_is_replaced_where_that_is_asked_for(store: Path, run: Path) -> None:
    before = weights(run)
    (run / "tensorboard").mkdir()
    train(store, run, **OPTIONS, seed=1, overwrite=True)
    assert not same_tensors(before, weights(run))
    assert not (run / "tensorboard").exists()
    (run / "notes.txt").write_text("the good one")
    now = contents(run)
    with pytest.raises(LayoutError, match=r"found 'notes\.txt' in it; choose another --out"):
        train(store, run, **OPTIONS, overwrite=True)
    assert contents(run) == now
    # A run may have notes beside it.
    train(store, run, **OPTIONS, seed=1)


@pytest.mark.parametrize("name", ["notes.txt", "best.pt", "predictions"])
def test_a_folder_of_something_else_is_left_alone(store: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text("mine")
    with pytest.raises(LayoutError, match=f"found '{name}' in it; choose another --out"):
        train(store, tmp_path / "out", **OPTIONS)
    assert contents(tmp_path / "out") == {name: b"mine"}


def test_a_file_is_no_folder(store: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(NimprepError, match=r"out: expected .*found "):
        train(store, tmp_path / "out", **OPTIONS)
    assert (tmp_path / "out").read_text() == "mine"


@pytest.mark.parametrize("way", ["itself", "in it", "a link"])
def test_nothing_is_written_into_a_store(store: Path, tmp_path: Path, way: str) -> None:
    ours = Path(shutil.copytree(store, tmp_path / "s.zarr"))
    before = contents(ours)
    out = {"itself": ours, "in it": ours / "run"}.get(way, tmp_path / "link")
    if way == "a link":
        out.symlink_to(ours)
    with pytest.raises(LayoutError, match="expected a place outside"):
        train(ours, out, **OPTIONS)
    assert contents(ours) == before
    assert nimprep.open_store(ours).ids


def test_two_do_not_train_in_one_folder(store: Path, run: Path) -> None:
    before = contents(run)
    with (
        locked_folder(run),
        pytest.raises(StoreError, match="expected nobody else to change it, found one at work"),
    ):
        train(store, run, **OPTIONS, overwrite=True)
    assert contents(run) == before


def test_what_a_kill_left_half_written_is_no_run(store: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / ".0123.partial").write_text("half")
    assert train(store, out, **OPTIONS).steps == 1


@pytest.mark.parametrize("damage", ["cut", "another", "later"])
def test_a_damaged_state_is_one_line(store: Path, run: Path, damage: str) -> None:
    path = run / "last.pt"
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:1000])
    else:
        found = torch.load(path, weights_only=True)
        found = {"a": 1} if damage == "another" else {**found, "nimprep_run": "2.0"}
        torch.save(found, path)
    with pytest.raises(LayoutError, match=r"last\.pt: expected .*--overwrite") as raised:
        train(store, run, **OPTIONS)
    assert "\n" not in str(raised.value)


def test_a_run_does_not_go_on_without_its_best_weights(store: Path, run: Path) -> None:
    (run / "best.pt").unlink()
    with pytest.raises(LayoutError, match=r"best\.pt: expected the best weights .*; put them back"):
        train(store, run, **OPTIONS)
    train(store, run, **OPTIONS, overwrite=True)
    assert (run / "best.pt").exists()


def test_a_refused_call_leaves_nothing(store: Path, tmp_path: Path) -> None:
    for wrong, said in [
        ({"setup": "rgb+termal"}, "setup: expected one of rgb, "),
        ({"setup": "hha"}, "setup: expected one of two parts for mfnet"),
        ({"network": None}, "network: expected one of fcn8s, .*found none; give --network"),
        ({"crop": (32, 64)}, "crop: expected 64,64 or more, found 32,64"),
        ({"crop": "none", "scale": (0.5, 2.0)}, "scale: expected it with a crop"),
        ({"stages": 3}, "stages: expected none for mfnet"),
        ({"weights": tmp_path / "none.pth"}, "none.pth: expected a file of weights, found No such"),
        ({"head_lr": 2.0}, "head_lr: expected 1 for mfnet"),
        ({"device": "tpu"}, "device: expected auto, cpu"),
        ({"device": "cuda:99"}, "device: expected one of . GPUs, found 'cuda:99'; give cpu"),
        ({"normalize": "hope"}, "normalize: expected one of constants"),
    ]:
        with pytest.raises(NimprepError, match=said) as raised:
            train(store, tmp_path / "out", **{**OPTIONS, **wrong})
        assert "\n" not in str(raised.value)
    assert [*tmp_path.iterdir()] == []
