"""Cases 13 and 14: splits that a dataset's authors chose, and test sets without labels."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import nimprep
from nimprep.conversion.append import append_frames
from nimprep.errors import LayoutError
from nimprep.store.info import info_text, store_info
from tests.cases.cases import nimprep_run
from tests.fakes import write_gmrp

LENS = (30, 30, 16, 12)
RIGHT = {"0": "train", "1": "train", "2": "train", "3": "val", "4": "test", "5": "test"}


def splits(store: nimprep.Store) -> dict[str, str]:
    return {i.rpartition("/")[2]: split for i, split in store.splits.items()}


def test_folders_called_train_val_and_test_give_the_split(
    case: Callable[[str], Path], tmp_path: Path
) -> None:
    root = case("14-")
    said = (
        r"a: official split by folders: train 3, val 1, test 2; \"split\": false in the "
        "description or --split-by to split anew$"
    )
    with pytest.warns(UserWarning, match=said):
        store = nimprep.convert(root / "a", tmp_path / "s.zarr", description=root / "a.json")
    assert splits(store) == RIGHT
    assert store.about.fixed_splits["val"] == ["val/3"]


def test_an_explicit_rule_splits_anew_and_that_is_said(
    case: Callable[[str], Path], tmp_path: Path
) -> None:
    root = case("14-")
    said = r"the official split \(train 3, val 1, test 2\) is not kept, as another is given"
    with pytest.warns(UserWarning, match=said):
        store = nimprep.convert(
            root / "a", tmp_path / "s.zarr", description=root / "a.json", split_by="frame"
        )
    ids = [f"{RIGHT[i]}/{i}" for i in RIGHT]
    assert store.splits == nimprep.splits.split_by_frame(sorted(ids))
    assert store.about.fixed_splits == {}


def test_lists_beside_the_images_give_the_split(
    case: Callable[[str], Path], tmp_path: Path
) -> None:
    root = case("14-")
    said = "official split by the lists test.txt and train.txt and val.txt: train 3, val 1, test 2"
    with pytest.warns(UserWarning, match=said):
        store = nimprep.convert(root / "b", tmp_path / "s.zarr", description=root / "b.json")
    assert splits(store) == RIGHT
    said = info_text(store_info(store.path))
    assert "split    train 3, val 1, test 2 (as its authors chose)" in said


@pytest.mark.parametrize("given", ["", "train.txt"])
def test_lists_can_be_given(case: Callable[[str], Path], tmp_path: Path, given: str) -> None:
    root = case("14-")
    lists = tmp_path / "lists"
    lists.mkdir()
    for path in (root / "b").glob("*.txt"):
        path.rename(lists / path.name)
    arguments = ("--description", root / "b.json", "--split-file", lists / given)
    done = nimprep_run("convert", root / "b", tmp_path / "s.zarr", *arguments)
    assert done.exit_code == 0, done.stderr
    store = nimprep.open_store(tmp_path / "s.zarr")
    assert splits(store) == RIGHT
    assert store.about.split == {"rule": "file"}


def test_a_store_is_split_by_lists_too(case: Callable[[str], Path], tmp_path: Path) -> None:
    root = case("14-")
    lists = tmp_path / "lists"
    lists.mkdir()
    for path in (root / "b").glob("*.txt"):
        path.rename(lists / path.name)
    nimprep.convert(root / "b", tmp_path / "s.zarr", description=root / "b.json")
    done = nimprep_run("split", tmp_path / "s.zarr", "--import", lists / "val.txt")
    assert done.exit_code == 0, done.stderr
    store = nimprep.open_store(tmp_path / "s.zarr")
    assert splits(store) == RIGHT
    assert store.about.split == {"rule": "file"}
    (lists / "val.txt").write_text("rgb/nobody.png\n")
    done = nimprep_run("split", tmp_path / "s.zarr", "--import", lists / "val.txt")
    assert done.exit_code == 1
    assert "val.txt: line 1: 'rgb/nobody.png' is neither id nor file" in done.stderr
    assert splits(nimprep.open_store(tmp_path / "s.zarr")) == RIGHT


def test_a_test_set_without_labels_is_255_and_said(
    case: Callable[[str], Path], tmp_path: Path
) -> None:
    root = case("13-")
    done = nimprep_run("convert", root, tmp_path / "s.zarr", "--description", root / "d.json")
    assert done.exit_code == 0, done.stderr
    assert "official split by folders: train 4, test 2;" in done.stderr
    assert (
        "none of the 2 frames of split test has labels: there they are 255 through" in done.stderr
    )
    store = nimprep.open_store(tmp_path / "s.zarr")
    assert [bool((store[i]["label"] == 255).all()) for i in range(6)] == [True] * 2 + [False] * 4
    arguments = ("--description", root / "d.json", "--split-by", "frame", "--overwrite")
    done = nimprep_run("convert", root, tmp_path / "s.zarr", *arguments)
    assert done.exit_code == 0, done.stderr
    assert "(train 4, test 2) is not kept, but for test 2 without labels, as" in done.stderr
    again = nimprep.open_store(tmp_path / "s.zarr").splits
    assert [i for i, split in again.items() if split == "test"] == ["test/4", "test/5"]
    assert sorted(again.values()).count("val") == 1


def test_a_label_lost_in_a_labelled_split_is_a_bad_frame(case: Callable[[str], Path]) -> None:
    root = case("13-")
    (root / "label/train/2.png").unlink()
    done = nimprep_run("convert", root, root / "s.zarr", "--description", root / "d.json")
    assert done.exit_code == 1
    done = nimprep_run("convert", root, root.parent / "s", "--description", root / "d.json")
    assert "label/train/2.png: expected label of frame 'train/2', found none" in done.stderr


def test_gmrp_with_lists_beside_rgb_is_split_by_them(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "gmrp", frames=6)
    (raw / "train.txt").write_text("000000\nrgb/000001.png\nlabel/000002 # not a comment\n")
    (raw / "test.lst").write_text("# ids\n\nrgb/000003.png label/000003.png\n")
    options = {"camera": (30, 30, 16, 12)}
    with pytest.warns(UserWarning, match=r"train 3, test 1, 2 in none; "):
        store = nimprep.convert(raw, tmp_path / "s.zarr", **options)
    assert list(store.splits.values()) == ["train"] * 3 + ["test"] + ["none"] * 2
    (raw / "train.txt").write_text("000000\n000003\n")
    with pytest.raises(LayoutError, match=r"train.txt: line 2: .*'000003' in test too.*--split-by"):
        nimprep.convert(raw, tmp_path / "t.zarr", **options)
    nimprep.convert(raw, tmp_path / "t.zarr", split_by="frame", **options)


def test_a_store_of_an_official_split_keeps_it_when_it_is_split_anew(
    case: Callable[[str], Path], tmp_path: Path
) -> None:
    root, store = case("14-"), tmp_path / "s.zarr"
    assert (
        nimprep_run("convert", root / "a", store, "--description", root / "a.json").exit_code == 0
    )
    done = nimprep_run("split", store, "--split-by", "frame")
    assert splits(nimprep.open_store(store)) == RIGHT
    assert done.stderr == (
        "note: frames whose split the dataset's authors chose keep it (test 2, train 3, val 1); "
        "--import moves them\n"
    )


def test_an_official_split_that_joins_a_store_of_another_is_said_not_to_be_kept(
    tmp_path: Path,
) -> None:
    more = write_gmrp(tmp_path / "more", frames=6)
    for path in more.glob("*/00000[0-2].png"):
        path.unlink()
    nimprep.convert(write_gmrp(tmp_path / "gmrp", frames=3), tmp_path / "s.zarr", camera=LENS)
    (more / "train.txt").write_text("000003\n")
    (more / "test.txt").write_text("000004\n000005\n")
    said = (
        r"\(train 1, test 2\) is not kept, .*, or is the store's; frames of its test may be in tr"
    )
    with pytest.warns(UserWarning, match=said):
        append_frames(more, tmp_path / "s.zarr", camera=LENS)
    assert nimprep.open_store(tmp_path / "s.zarr").about.fixed_splits == {}
