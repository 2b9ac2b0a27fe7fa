from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from nimprep import convert, open_store
from nimprep.frame import Frame, LabelClass
from nimprep.modality import MODALITIES
from nimprep.readers import DatasetInfo, Reader
from nimprep.readers.base import WrappedReader
from nimprep.readers.crop import CroppedReader, Margins, find_invalid_sides
from nimprep.readers.gmrp import open_gmrp
from nimprep.readers.subset import SubsetReader
from tests.fakes import SIZE, contents, write_gmrp

MEMBERS = [name for name in vars(Reader) if not name.startswith("_")]


class Handmade:
    """A reader that is of no class of nimprep's, and answers otherwise than most."""

    def __init__(self, root: Path) -> None:
        self._frames = open_gmrp(root)

    @property
    def info(self) -> DatasetInfo:
        return DatasetInfo("handmade", (LabelClass(0, "all", (1, 2, 3)),), "user", ("by hand",))

    @property
    def root(self) -> Path:
        return self._frames.root

    @property
    def ids(self) -> tuple[str, ...]:
        return self._frames.ids

    def group(self, frame_id: str) -> str:
        return f"scene {frame_id[-1]}"

    def fixed_split(self, frame_id: str) -> Any:
        return "test" if frame_id == self.ids[0] else None

    def sources(self, frame_id: str) -> tuple[Path, ...]:
        return self._frames.sources(frame_id)[::-1]

    def metadata(self, frame_id: str) -> dict[str, Any]:
        return {"weather": f"rain {frame_id}"}

    def shape(self, frame_id: str) -> tuple[int, int]:
        return SIZE

    def read(self, frame_id: str, modalities: Collection[str] = MODALITIES) -> Frame:
        return replace(self._frames.read(frame_id, modalities), group=self.group(frame_id))


@pytest.fixture
def gmrp(tmp_path: Path) -> Path:
    root = write_gmrp(tmp_path / "gmrp")
    (root / "camera.json").write_text('{"fx": 30, "fy": 31, "cx": 15, "cy": 11}')
    return root


def answer(reader: Reader, name: str) -> Any:
    member = getattr(reader, name)
    found = member("000001") if callable(member) else member
    return (found.id, found.camera, found.rgb.tobytes()) if name == "read" else found


@pytest.mark.parametrize("name", MEMBERS)
def test_a_wrapped_reader_answers_as_the_reader_in_it(gmrp: Path, name: str) -> None:
    reader = Handmade(gmrp)
    assert answer(WrappedReader(reader), name) == answer(reader, name)


def test_all_members_of_the_protocol_are_asked_for() -> None:
    assert sorted(MEMBERS) == [
        *("fixed_split", "group", "ids", "info", "metadata"),
        *("read", "root", "shape", "sources"),
    ]


@pytest.mark.parametrize("name", sorted({*MEMBERS} - {"shape", "read"}))
def test_a_crop_changes_shape_and_frame_alone(gmrp: Path, name: str) -> None:
    reader = Handmade(gmrp)
    assert answer(CroppedReader(reader, Margins(1, 2, 3, 4)), name) == answer(reader, name)


@pytest.mark.parametrize("name", sorted({*MEMBERS} - {"ids"}))
def test_a_subset_changes_the_ids_alone(gmrp: Path, name: str) -> None:
    reader = Handmade(gmrp)
    subset = SubsetReader(reader, ["000001"])
    assert subset.ids == ("000001",)
    assert answer(subset, name) == answer(reader, name)


def test_a_reader_that_is_of_no_class_of_ours_can_be_looked_through_for_a_crop(gmrp: Path) -> None:
    handmade, ours = Handmade(gmrp), open_gmrp(gmrp)
    assert find_invalid_sides(handmade, 1) == find_invalid_sides(ours, 1)


def test_a_reader_that_is_of_no_class_of_ours_is_converted(
    gmrp: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    convert(gmrp, tmp_path / "ours.zarr", crop=(1, 2, 3, 4), modalities=("rgb", "depth"))
    monkeypatch.setattr("nimprep.readers.gmrp.open_gmrp", lambda root, **_: Handmade(root))
    with pytest.warns(UserWarning, match="by hand"):
        convert(gmrp, tmp_path / "hand.zarr", crop=(1, 2, 3, 4), modalities=("rgb", "depth"))
    ours, hand = (contents(tmp_path / f"{name}.zarr") for name in ("ours", "hand"))
    images = [key for key in ours if key.startswith(("rgb/", "depth/"))]
    assert len(images) > 2
    assert [key for key in images if ours[key] != hand[key]] == []
    store = open_store(tmp_path / "hand.zarr")
    assert store.attributes["dataset"] == "handmade"
    assert store.attributes["fixed_splits"] == {"test": ["000000"]}
    assert store.attributes["frame_metadata"]["weather"]["values"][1] == "rain 000001"
    assert [frame.group for frame in store][1] == "scene 1"
