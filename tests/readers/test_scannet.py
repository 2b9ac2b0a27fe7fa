"""ScanNet: two sizes, its own label ids, lists of scenes."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import nimprep
from nimprep.errors import LayoutError
from nimprep.inspection.inspection import inspect_source
from nimprep.readers import ReaderOptions, open_reader
from tests.fakes import write_png
from tests.scenes import CX, CY, FX, FY, SIZE, scene

SCENES = ("scene0000_00", "scene0000_01", "scene0012_00")
TO_NYU = {7: 2, 11: 1, 23: 0, 26: 29}


def matrix(fx: float, fy: float, cx: float, cy: float) -> str:
    return f"{fx} 0 {cx} 0\n0 {fy} {cy} 0\n0 0 1 0\n0 0 0 1\n"


def write_scannet(root: Path, *, lists: bool = False, table: bool = False) -> dict[str, int]:
    """Write two frames per scene, colour and labels of twice depth's size; return seeds by id."""
    seeds: dict[str, int] = {}
    double = (2 * SIZE[1], 2 * SIZE[0])
    for name in SCENES:
        folder = root / "scans" / name
        for n in (0, 20):
            seed = seeds[f"{name}/{n}"] = len(seeds)
            made = scene(seed)
            (folder / "color").mkdir(parents=True, exist_ok=True)
            write_png(folder / "color" / f"{n}.png", np.asarray(made.rgb.repeat(2, 0).repeat(2, 1)))
            raw = np.round(made.depth_m * 1000).astype(np.uint16)
            write_png(folder / "depth" / f"{n}.png", raw)
            label = cv2.resize(made.label, double, interpolation=cv2.INTER_NEAREST)
            write_png(folder / "label-filt" / f"{n}.png", label.astype(np.uint16))
        (folder / "intrinsic").mkdir()
        (folder / "intrinsic" / "intrinsic_depth.txt").write_text(matrix(FX, FY, CX, CY))
    if lists:
        (root / "scannetv2_train.txt").write_text("scene0000_00\nscene0000_01\nscene0700_00\n")
        (root / "scannetv2_val.txt").write_text("scene0012_00\n")
    if table:
        rows = "".join(f"{raw}\tx\t{nyu}\n" for raw, nyu in TO_NYU.items())
        (root / "scannetv2-labels.combined.tsv").write_text("id\traw_category\tnyu40id\n" + rows)
    return seeds


def mapped(label: np.ndarray, values: dict[int, int]) -> np.ndarray:
    return np.vectorize(lambda value: values.get(value, 255))(label).astype(np.uint8)


@pytest.mark.parametrize("label_set", [None, "train-ids"])
def test_frames_are_what_the_folders_and_the_truth_say(
    tmp_path: Path, label_set: str | None
) -> None:
    seeds = write_scannet(tmp_path / "s", lists=True, table=True)
    reader = open_reader(tmp_path / "s", ReaderOptions(label_set=label_set))
    assert reader.info.name == "scannet"
    assert reader.info.hha_ground == "lowest"
    assert reader.ids == tuple(sorted(seeds))
    less = 0 if label_set is None else 1
    nyu = {raw: (each - less if each else 255) for raw, each in TO_NYU.items()}
    for frame_id, seed in seeds.items():
        frame, made = reader.read(frame_id), scene(seed)
        assert reader.group(frame_id) == frame_id.partition("_")[0]
        split = "val" if frame_id.startswith("scene0012") else "train"
        assert reader.fixed_split(frame_id) == split
        camera = frame.camera
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (FX, FY, CX, CY)
        assert camera.shape == SIZE
        np.testing.assert_array_equal(frame.rgb, made.rgb)
        assert frame.depth_m is not None
        np.testing.assert_allclose(frame.depth_m, made.depth_m, atol=0.0005)
        np.testing.assert_array_equal(frame.label, mapped(made.label, nyu))


def test_without_table_and_lists_ids_are_kept_and_frames_are_free(tmp_path: Path) -> None:
    seeds = write_scannet(tmp_path / "s")
    # One that does not fit into a byte.
    path = tmp_path / "s" / "scans" / "scene0012_00" / "label-filt" / "0.png"
    write_png(path, np.full((2 * SIZE[0], 2 * SIZE[1]), 1163, np.uint16))
    reader = open_reader(tmp_path / "s")
    for told in ("labels are ScanNet's own ids", "lists of scenes"):
        assert any(told in note for note in reader.info.notes)
    assert {reader.fixed_split(i) for i in reader.ids} == {None}
    label = reader.read("scene0000_00/0").label
    np.testing.assert_array_equal(label, scene(seeds["scene0000_00/0"]).label)
    label = reader.read("scene0012_00/0").label
    assert label is not None
    assert (label == 255).all()


def test_two_cameras_of_another_aspect_draw_depth_into_colour(tmp_path: Path) -> None:
    write_scannet(tmp_path / "s")
    # Two rows less than twice as many, and colour's own matrix.
    for folder in sorted((tmp_path / "s" / "scans").iterdir()):
        for path in [*folder.glob("color/*"), *folder.glob("label-filt/*")]:
            image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            assert image is not None
            cv2.imwrite(str(path), image[2:-2])
        text = matrix(2 * FX, 2 * FY, 2 * CX + 0.5, 2 * CY - 1.5)
        (folder / "intrinsic" / "intrinsic_color.txt").write_text(text)
    reader = open_reader(tmp_path / "s")
    frame, made = reader.read("scene0000_00/0"), scene(0)
    assert (frame.camera.fx, frame.camera.cy) == (2 * FX, 2 * CY - 1.5)
    assert frame.camera.shape == (2 * SIZE[0] - 4, 2 * SIZE[1])
    assert frame.depth_m is not None
    # On the wall, which is flat: away from the sky above it and from the road.
    wall = made.label == 11
    inner = cv2.erode(wall.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    inner = inner.repeat(2, 0).repeat(2, 1)[2:-2]
    inner[:, [0, -1]] = False
    assert inner.any()
    np.testing.assert_allclose(frame.depth_m[inner], 25, rtol=1e-3)


def test_frames_25k_have_labels_of_nyu(tmp_path: Path) -> None:
    folder = tmp_path / "s" / "scannet_frames_25k" / "scene0003_02"
    made = scene(5)
    write_png(folder / "color" / "000100.png", made.rgb)
    raw = np.round(made.depth_m * 1000).astype(np.uint16)
    write_png(folder / "depth" / "000100.png", raw)
    label = np.vectorize(TO_NYU.get)(made.label).astype(np.uint8)
    write_png(folder / "label" / "000100.png", label)
    for kind in ("color", "depth"):
        (folder / f"intrinsics_{kind}.txt").write_text(matrix(FX, FY, CX, CY))
    reader = open_reader(tmp_path / "s")
    assert (reader.info.name, reader.ids) == ("scannet-25k", ("scene0003_02/000100",))
    assert reader.group(reader.ids[0]) == "scene0003"
    frame = reader.read(reader.ids[0])
    np.testing.assert_array_equal(frame.label, np.where(label == 0, 255, label))
    assert frame.depth_m is not None
    wall = made.label == 11
    np.testing.assert_allclose(frame.depth_m[4:6, 2:-2][wall[4:6, 2:-2]], 25, rtol=1e-3)


def test_what_is_wrong_is_named(tmp_path: Path) -> None:
    root = tmp_path / "data" / "s"
    write_scannet(root, lists=True, table=True)
    store = nimprep.convert(root, tmp_path / "o.zarr")
    assert "CVPR 2017" in store.about.references[0]["citation"]
    assert inspect_source(root).reader == "scannet"
    with pytest.raises(LayoutError, match=r"did you mean .*scans\?|did you mean .*s\?"):
        open_reader(root / "scans" / "scene0000_00")
    with pytest.raises(LayoutError, match=r"did you mean .*/s"):
        open_reader(root.parent)
    (root / "scannetv2_test.txt").write_text("scene0012_00\n")
    with pytest.raises(
        LayoutError, match=r"expected each scene in one split, found 'scene0012_00'"
    ):
        open_reader(root)
    (root / "scannetv2_test.txt").unlink()
    (root / "scannetv2-labels.combined.tsv").write_text("id\tcategory\n1\twall\n")
    with pytest.raises(LayoutError, match=r"expected columns id and nyu40id"):
        open_reader(root)
    for path in sorted(root.rglob("depth/*.png")):
        path.unlink()
    with pytest.raises(LayoutError, match=r"expected depth files of scannet.*SensReader"):
        open_reader(root)
