"""What lies beside a dataset is not taken for it; what is a user's own is nobody's."""

from __future__ import annotations

from pathlib import Path

import pytest

import nimprep
from nimprep.conversion.journal import option_values
from nimprep.errors import LayoutError
from nimprep.inspection.layouts import fitting_reader, meant_instead
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.recognition import recognised
from tests.readers.test_tum import write_sequence


def put(root: Path, *names: str) -> Path:
    for name in names:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    return root


OWN = {
    "plain": ("rgb/1.png", "depth/1.png", "label/1.png"),
    "scenes": ("a/rgb/1.png", "a/depth/1.png", "b/rgb/1.png", "b/depth/1.png"),
    "scenes, lists elsewhere": ("a/rgb/1.png", "a/depth/1.png", "b/rgb.txt", "b/depth.txt"),
    "depth of scenes": ("a/color/1.png", "a/depth/1.png"),
    "splits": ("train/rgb/1.png", "train/depth/1.png", "test/rgb/1.png"),
    "colour of splits": ("train/color/1.png", "train/depth/1.png"),
    "images": ("images/train/1.png", "annotations/train/1.png"),
    "training": ("training/rgb/1.png", "training/depth/1.png", "training/label/1.png"),
    "DFormer's, one above": ("NYU/RGB/1.jpg", "NYU/Depth/1.png", "NYU/Label/1.png"),
    "image_2": ("training/image_2/1.png", "training/disp/1.png"),
}


@pytest.mark.parametrize("name", OWN)
def test_folders_of_ones_own_are_taken_for_no_dataset(tmp_path: Path, name: str) -> None:
    # Beside a sequence of TUM, and below a folder that therefore is one of sequences.
    write_sequence(tmp_path / "data" / "freiburg1", count=1)
    root = put(tmp_path / "data" / "mine", *OWN[name])
    try:
        found = recognised(root)
    except LayoutError as error:
        said = str(error)
        assert said.endswith(f"nimprep inspect {root} says what it is")
    else:
        # By their folders' names alone, of which their reader then says what is missing.
        assert found.reader in ("gmrp", "kitti-road")
        with pytest.raises(LayoutError, match=r"expected"):
            open_reader(root)
    assert meant_instead(root) is None


def test_signs_of_a_sequence_are_in_one_folder(tmp_path: Path) -> None:
    put(tmp_path, "a/rgb/1.png", "a/depth/1.png", "b/rgb.txt", "b/depth.txt")
    with pytest.raises(LayoutError, match="expected a known layout"):
        recognised(tmp_path)
    put(tmp_path, "b/rgb/1.png")
    assert recognised(tmp_path).reader == "tum"


def test_another_dataset_beside_sequences_is_not_dropped(tmp_path: Path) -> None:
    seeds = write_sequence(tmp_path / "freiburg1")
    put(tmp_path, "notes/a.txt", "more/rgb/1.png")
    assert recognised(tmp_path).reader == "tum"
    put(tmp_path, "orfd/training/s/image_data/1.png", "orfd/training/s/calib/1.txt")
    expected = r"expected files of one dataset, found those of tum and, in orfd, of orfd; give"
    with pytest.raises(LayoutError, match=expected):
        recognised(tmp_path)
    notes: list[str] = []
    assert fitting_reader(tmp_path, notes) is None
    assert "in orfd, of orfd" in notes[0]
    reader = open_reader(tmp_path, ReaderOptions(reader="tum"))
    assert reader.ids == tuple(f"freiburg1/{time}" for time in sorted(seeds))


@pytest.mark.parametrize("deep", ["training", "training/s", "training/s/calib"])
def test_a_part_of_a_dataset_leads_to_it_and_what_lies_there_does_not(
    tmp_path: Path, deep: str
) -> None:
    root = put(tmp_path / "set", "training/s/image_data/1.png", "training/s/calib/1.txt")
    with pytest.raises(LayoutError, match=f"did you mean {root}\\?"):
        recognised(root / deep)
    beside = put(root / "training" / "mine", "images/1.png").parent / "mine"
    with pytest.raises(LayoutError, match=f"nimprep inspect {beside} says"):
        recognised(beside)


def test_a_folder_near_that_has_several_datasets_does_not_hide_what_is_wrong(
    tmp_path: Path,
) -> None:
    put(tmp_path, "training/s/image_data/1.png", "training/s/calib/1.txt")
    put(tmp_path, "training/Town01/rgb/1.png", "training/Town01/depth/1.png")
    mine = put(tmp_path / "mine", "a.png")
    with pytest.raises(LayoutError, match=f"{mine}: expected a known layout"):
        recognised(mine)


def test_lists_may_be_given_by_their_folder_and_tell_in_the_store(tmp_path: Path) -> None:
    lists = tmp_path / "lists"
    options = nimprep.ConvertOptions(lists=put(lists, "train.lst", "readme.md"))
    before = option_values(options)["lists"]
    (lists / "readme.md").write_text("other")
    assert option_values(options)["lists"] == before
    (lists / "train.lst").write_text("a\n")
    assert option_values(options)["lists"] != before
    one = nimprep.ConvertOptions(lists=lists / "train.lst")
    assert option_values(one)["lists"].startswith("sha256:")
