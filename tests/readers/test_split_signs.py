"""What is called like a split and is not taken is said; lists mean frames that are there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from nimprep.errors import LayoutError
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.base import Reader
from tests.fakes import write_gmrp
from tests.readers.test_folder import GMRP_DESCRIBED


def scenes(root: Path, *names: str) -> Path:
    """Write a dataset whose scenes lie in folders of these names, a frame in each."""
    for name in names:
        write_gmrp(root / name, frames=1)
    return root


def opened(root: Path, **changes: Any) -> Reader:
    files = {
        "version": "1.1",
        "rgb": "{scene}/rgb/{name}.png",
        "id": "{scene}/{name}",
        "depth": {"files": "{scene}/depth_u16/{name}.png", "scale_m": 0.001},
        "label": {"files": "{scene}/label/{name}.png"},
    }
    (root / "d.json").write_text(json.dumps({**GMRP_DESCRIBED, **files, **changes}))
    return open_reader(root, ReaderOptions(description=root / "d.json"))


def split_notes(reader: Reader) -> list[str]:
    return [note for note in reader.info.notes if "split" in note]


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("train_set", "test_set"), "test_set/, train_set/"),
        (("val", "test"), "test/, val/"),
        (("a", "b", "c", "testset"), "testset/"),
        (("train", "eval2"), "eval2/, train/"),
    ],
)
def test_folders_called_like_splits_that_are_not_taken_are_said(
    tmp_path: Path, names: tuple[str, ...], said: str
) -> None:
    reader = opened(scenes(tmp_path, *names))
    (note,) = split_notes(reader)
    assert note.startswith(f"no official split is taken, though {said} may be of one: ")
    assert {reader.fixed_split(i) for i in reader.ids} == {None}
    assert split_notes(opened(tmp_path, split=False)) == []


@pytest.mark.parametrize(
    "names", [("test.txt",), ("trainval.txt", "test.txt"), ("lists/own/train_1.lst",)]
)
def test_lists_called_like_splits_that_are_not_taken_are_said(
    tmp_path: Path, names: tuple[str, ...]
) -> None:
    scenes(tmp_path, "a", "b")
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("a/000000\n")
    (note,) = split_notes(opened(tmp_path))
    assert f"though {', '.join(sorted(names))} may be of one" in note


def test_one_folder_for_all_and_notes_of_frames_are_no_splits(tmp_path: Path) -> None:
    scenes(tmp_path, "training/a", "training/b", "contest")
    (tmp_path / "contest").rename(tmp_path / "training/contest")
    (tmp_path / "pose").mkdir()
    (tmp_path / "pose/test_000001.txt").write_text("1 0 0")
    files = {
        "rgb": "training/{scene}/rgb/{name}.png",
        "depth": {"files": "training/{scene}/depth_u16/{name}.png", "scale_m": 0.001},
        "label": {"files": "training/{scene}/label/{name}.png"},
    }
    reader = opened(tmp_path, **files)
    assert len(reader.ids) == 3
    assert split_notes(reader) == []


def test_a_scene_that_is_not_there_is_not_another_that_is(tmp_path: Path) -> None:
    scenes(tmp_path, "a", "c")
    (tmp_path / "train.txt").write_text("a/rgb/000000.png\n")
    (tmp_path / "test.txt").write_text("b/rgb/000000.png\n")
    write_gmrp(tmp_path / "c", frames=2)
    (tmp_path / "val.txt").write_text("b/rgb/000001.png\n")
    reader = opened(tmp_path)
    assert {i: reader.fixed_split(i) for i in reader.ids} == {
        "a/000000": "train",
        "c/000000": "none",
        "c/000001": "none",
    }
    assert "2 lines of " in split_notes(reader)[0] + "".join(reader.info.notes)


def test_lists_of_paths_elsewhere_find_frames_by_what_they_end_with(tmp_path: Path) -> None:
    scenes(tmp_path, "release/a", "release/b")
    (tmp_path / "train.txt").write_text("/home/me/set/a/rgb/000000.png\n")
    (tmp_path / "test.txt").write_text("/home/me/set/b/rgb/000000.png\n")
    files = {
        "rgb": "release/{scene}/rgb/{name}.png",
        "depth": {"files": "release/{scene}/depth_u16/{name}.png", "scale_m": 0.001},
        "label": {"files": "release/{scene}/label/{name}.png"},
    }
    reader = opened(tmp_path, **files)
    assert [reader.fixed_split(i) for i in reader.ids] == ["train", "test"]


def test_groups_of_placeholders_that_rgb_has_not_are_refused(tmp_path: Path) -> None:
    scenes(tmp_path, "a", "b")
    with pytest.raises(LayoutError, match=r"group '\{place\}' of .* no \{place\} there; name it"):
        opened(tmp_path, group="{place}")


def test_frames_that_share_an_image_are_said(tmp_path: Path) -> None:
    scenes(tmp_path, "a", "b")
    write_gmrp(tmp_path / "b", frames=3)
    for number in (1, 2):
        (tmp_path / f"b/depth_u16/00000{number}.png").unlink()
    depth = {"files": "{scene}/depth_u16/{other}.png", "scale_m": 0.001}
    reader = opened(tmp_path, depth=depth)
    (note,) = [note for note in reader.info.notes if "share" in note]
    assert note == (
        "3 frames share 1 file of depth, first b/depth_u16/000000.png; if each has its own, its "
        "pattern needs the placeholders of rgb's"
    )


def paired(root: Path, columns: list[str], pairs: str = "{scene}/pairs.txt") -> Reader:
    return opened(root, match={"pairs": pairs, "columns": columns})


def test_pairs_hold_for_the_folder_of_their_list(tmp_path: Path) -> None:
    for scene in "ab":
        write_gmrp(tmp_path / scene, frames=3)
        rows = [f"rgb/00000{a}.png depth_u16/00000{(a + 1) % 3}.png\n" for a in range(3)]
        (tmp_path / scene / "pairs.txt").write_text("".join(rows))
    reader = paired(tmp_path, ["rgb", "depth"])
    found = [reader.sources(i)[1].relative_to(tmp_path).as_posix() for i in reader.ids]
    assert found == [f"{scene}/depth_u16/00000{n}.png" for scene in "ab" for n in (1, 2, 0)]
    with pytest.raises(
        LayoutError, match=r"lists or columns in \"match\", found 'dpeth'; describe"
    ):
        paired(tmp_path, ["rgb", "dpeth"])
    with (tmp_path / "b/pairs.txt").open("a") as file:
        file.write("rgb/000000.png depth_u16/000000.png\n")
    with pytest.raises(
        LayoutError, match=r"one pair per colour image, found 'rgb/000000.png' with"
    ):
        paired(tmp_path, ["rgb", "depth"])


def test_a_video_of_all_frames_is_named(tmp_path: Path) -> None:
    scenes(tmp_path, "a")
    (tmp_path / "color.mp4").write_bytes(b"\0\0\0\x18ftypisom" + bytes(64))
    with pytest.raises(
        LayoutError, match=r"color.mp4: expected images, found a video \(MP4.*ffmpeg"
    ):
        opened(tmp_path, rgb="color.mp4")


@pytest.mark.parametrize(
    ("split", "said"),
    [
        (
            {"of": "{scene}", "names": {"a": "skip", "b": "skip"}},
            "its split leaves out all of them",
        ),
        (
            {"lists": {"train": "none_*.txt"}, "rest": "test"},
            r"lists 'none_\*.txt' of train, found no",
        ),
        (
            {"lists": {"train": "bad.txt"}, "rest": "test"},
            r"line 2: 'c/0' is no frame's id or file; ",
        ),
    ],
)
def test_a_split_that_finds_nothing_is_refused(
    tmp_path: Path, split: dict[str, Any], said: str
) -> None:
    scenes(tmp_path, "a", "b")
    (tmp_path / "bad.txt").write_text("a/000000\nc/0\n")
    with pytest.raises(LayoutError, match=said):
        opened(tmp_path, split=split)


def test_frames_that_a_split_leaves_out_are_said(tmp_path: Path) -> None:
    scenes(tmp_path, "a", "b", "c")
    (tmp_path / "own.txt").write_text("a/000000\n")
    said = "2 of 3 frames are left out, as their split is to be: first 'b/000000'"
    names = {"a": "train", "b": "skip", "c": "skip"}
    for split in (
        {"of": "{scene}", "names": names},
        {"lists": {"train": "own.txt"}, "rest": "skip"},
    ):
        reader = opened(tmp_path, split=split)
        assert reader.ids == ("a/000000",)
        assert split_notes(reader) == [said]


def test_frames_left_out_for_want_of_a_label_in_time_are_not_said_to_be_stored(
    tmp_path: Path,
) -> None:
    scenes(tmp_path, "train", "test")
    for path in tmp_path.glob("test/label/*.png"):
        path.rename(path.with_name("000009.png"))
    reader = opened(tmp_path, match={"by": "{name}"})
    assert reader.ids == ("train/000000",)
    notes = [note for note in reader.info.notes if "label" in note]
    assert len(notes) == 1
    assert "1 of 2 colour images have no label within 0.02 s" in notes[0]
