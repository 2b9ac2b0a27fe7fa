"""What inspect writes converts, to the depth, groups and splits that the layouts were made of."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import nimprep
from nimprep.inspection.inspection import inspect_source
from nimprep.readers.description_file import description_from_document
from nimprep.readers.folder import FolderReader
from tests.inspection import scenes

pytestmark = pytest.mark.usefixtures("unknown")


@dataclass(frozen=True)
class Truth:
    """Say what a layout's frames are.

    Attributes
    ----------
    seed : callable
        Frame id to the scene's seed; None = the frame has no depth.
    groups : int
        How many scenes there are, 0 = none are said.
    frames : int
    atol, rtol : float
        Half a unit of depth and of the store's, or what a step of disparity is at 30 m.
    split : mapping, optional
        As the description has it.
    splits : tuple of int
        Frames that the authors put into train, val and test.
    """

    seed: Callable[[str], int | None]
    frames: int
    groups: int = 0
    atol: float = 0.002
    rtol: float = 0.0
    split: Any = None
    splits: tuple[int, int, int] = (0, 0, 0)


def _last(frame_id: str) -> int:
    return int(frame_id.rpartition("/")[2])


def _by_order(*parts: str) -> Callable[[str], int]:
    """Return a function that numbers frames by the part of an id, two frames each."""

    def seed(frame_id: str) -> int:
        place = next(k for k, part in enumerate(parts) if part in frame_id)
        return 2 * place + int(frame_id.replace("_000019", "")[-1])

    return seed


FOLDERS = {"of": "{split}"}
LISTS = {"train": "train.txt", "test": "test.txt"}
TRUTHS: dict[str, Truth] = {
    "orfd": Truth(
        lambda i: (_last(i) - 1623721491895) // 100, 8, 4, 0.005, split=FOLDERS, splits=(4, 2, 2)
    ),
    "cityscapes": Truth(
        _by_order("aachen", "bochum", "frankfurt", "berlin"),
        8,
        4,
        rtol=0.003,
        split=FOLDERS,
        splits=(4, 2, 2),
    ),
    "kitti_semantics": Truth(
        lambda i: _last(i) if "training" in i else None,
        6,
        rtol=0.003,
        split=FOLDERS,
        splits=(3, 0, 3),
    ),
    "vkitti2": Truth(_last, 24, 2, atol=0.011),
    "r2d": Truth(
        _by_order("Town02", "Town03", "Town01", "Town06"), 8, 4, split=FOLDERS, splits=(4, 2, 2)
    ),
    "nyuv2_nicr": Truth(_last, 4, split=FOLDERS, splits=(3, 0, 1)),
    "sunrgbd": Truth(
        lambda i: next(k for k, n in enumerate(("kv1", "kv2", "realsense", "xtion")) if n in i), 4
    ),
    "scannet": Truth(_last, 4, 2),
    "nyuv2_mat": Truth(_last, 4),
    "tum": Truth(lambda i: round((float(i) - 1305031102.1753) * 30), 4),
    "drno": Truth(
        _last, 3, split={"lists": {"train": "train.txt", "test": "test.txt"}}, splits=(2, 0, 1)
    ),
}


@pytest.mark.parametrize("name", TRUTHS)
def test_what_is_written_reads_as_the_layout_was_made(
    layout: Callable[[str], Path], layout_maker: ModuleType, name: str
) -> None:
    if name == "nyuv2_mat":
        pytest.importorskip("h5py")
    truth, root = TRUTHS[name], layout(name)
    found = inspect_source(root)
    assert found.description is not None
    assert found.description.get("split") == truth.split
    reader = FolderReader(root, description_from_document(found.description, name))
    assert len(reader.ids) == truth.frames
    assert len({reader.group(i) for i in reader.ids} - {""}) == truth.groups
    splits = Counter(reader.fixed_split(i) for i in reader.ids)
    assert tuple(splits[name] for name in ("train", "val", "test")) == truth.splits
    for frame_id in reader.ids:
        seed, depth = truth.seed(frame_id), reader.read(frame_id).depth_m
        if seed is None:
            assert depth is None or not depth.any()
            continue
        expected = layout_maker.scene(seed)[1]
        if name == "tum":
            # What its 16 bits cannot hold is no depth.
            expected = np.where(expected < 65535 / 5000, expected, 0)
        assert depth is not None
        np.testing.assert_array_equal(depth > 0, expected > 0)
        np.testing.assert_allclose(depth, expected, rtol=truth.rtol, atol=truth.atol)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", [*TRUTHS, "mfnet", "nyuv2_dformer", "rellis"])
def test_convert_takes_what_is_written(
    layout: Callable[[str], Path], tmp_path: Path, name: str
) -> None:
    if name == "nyuv2_mat":
        pytest.importorskip("h5py")
    found = inspect_source(layout(name))
    file = tmp_path / "description.json"
    file.write_text(json.dumps(found.description))
    store = nimprep.convert(
        layout(name), tmp_path / "out.zarr", description=file, modalities=("rgb",)
    )
    assert len(store) > 0


KNOWN = [
    scenes.kitti_completion,
    scenes.kitti_selection,
    scenes.carla_normalised,
    scenes.stanford,
    scenes.diode,
    scenes.tartanair,
    scenes.tartanair_bytes,
    scenes.replica,
    scenes.icl_nuim,
    scenes.eth3d,
    scenes.middlebury,
    scenes.scannetpp,
    scenes.matterport,
    scenes.seven_scenes,
    scenes.carla_alpha,
    scenes.swapped,
    scenes.nameless,
    scenes.centimetres,
    scenes.bare_numbers,
]


@pytest.mark.parametrize("write", KNOWN)
def test_what_is_written_of_other_kinds_reads_metres(
    tmp_path: Path, write: Callable[[Path], None]
) -> None:
    write(tmp_path)
    found = inspect_source(tmp_path)
    assert found.description is not None
    reader = FolderReader(tmp_path, description_from_document(found.description, "d"))
    truths = [scenes.street(k, closer)[1] for k in range(4) for closer in (1, 3, 4, 5)]
    assert len(reader.ids) >= 3
    for frame_id in reader.ids:
        depth = reader.read(frame_id).depth_m
        assert depth is not None
        errors = [np.abs(depth / np.maximum(t, 1e-3) - 1)[depth > 0].max() for t in truths]
        assert min(errors) < 0.02
