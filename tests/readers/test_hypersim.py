"""Hypersim: distance along the ray in HDF5, cameras that are tilted, a split in a table."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

import nimprep
from nimprep.errors import DecodeError, LayoutError
from nimprep.inspection.inspection import inspect_source
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.description_file import description_from_document
from nimprep.readers.hypersim import camera_of_projection
from nimprep.readers.recognition import recognised
from tests.scenes import SIZE, scene

H, W = SIZE
WIDE = np.array(
    [[3**0.5, 0, 0, 0], [0, 3**0.5 * W / H, 0, 0], [0, 0, -1.002, -2.002], [0, 0, -1, 0]]
)
"""OpenGL's projection of 60 degrees."""

FRAMES = (
    ("ai_001_001", "00", 0),
    ("ai_001_001", "01", 17),
    ("ai_002_003", "00", 3),
    ("ai_003_010", "00", 99),
)
RAW = {23: -1, 11: 1, 7: 2, 26: 40}
SPLITS = {"ai_001_001": "train", "ai_002_003": "val", "ai_003_010": "test"}


def shifted() -> np.ndarray:
    """Return a projection with the principal point off the middle, and another focal length."""
    made = WIDE.copy()
    made[0, 0], made[0, 2], made[1, 2] = 2.0, 0.1, -0.2
    return made


def intrinsics(projection: np.ndarray) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy of a projection whose image plane is not tilted."""
    # A point in front at (x, y, -1): ndc = (P00 x - P02, P11 y - P12).
    return (
        projection[0, 0] * W / 2,
        projection[1, 1] * H / 2,
        (1 - projection[0, 2]) * W / 2 - 0.5,
        (1 + projection[1, 2]) * H / 2 - 0.5,
    )


def rays(camera: tuple[float, float, float, float]) -> np.ndarray:
    fx, fy, cx, cy = camera
    v, u = np.mgrid[:H, :W]
    return np.sqrt(1 + ((u - cx) / fx) ** 2 + ((v - cy) / fy) ** 2)


def frame_id(seed: int) -> str:
    inner, camera, number = FRAMES[seed]
    return f"{inner}/cam_{camera}/{number:04d}"


def write_array(path: Path, array: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w") as file:
        file["dataset"] = array


def write_hypersim(root: Path, cameras: dict[str, np.ndarray] | None = None) -> Path:
    for seed, (inner, camera, number) in enumerate(FRAMES):
        made, images = scene(seed), root / inner / "images"
        projection = (cameras or {}).get(inner, WIDE)
        distance = made.depth_m * rays(intrinsics(projection))
        distance[made.depth_m == 0] = np.nan
        name = f"frame.{number:04d}"
        preview = images / f"scene_cam_{camera}_final_preview"
        preview.mkdir(parents=True, exist_ok=True)
        for kind in ("tonemap", "color"):
            shown = made.rgb[:, :, ::-1] if kind == "tonemap" else made.rgb * 0
            path = preview / f"{name}.{kind}.jpg"
            cv2.imwrite(str(path), shown, [cv2.IMWRITE_JPEG_QUALITY, 100])
        geometry = images / f"scene_cam_{camera}_geometry_hdf5"
        write_array(geometry / f"{name}.depth_meters.hdf5", distance.astype("f2"))
        label = np.vectorize(RAW.get)(made.label).astype("i2")
        write_array(geometry / f"{name}.semantic.hdf5", label)
        write_array(geometry / f"{name}.semantic_instance.hdf5", label * 7)
        hdr = images / f"scene_cam_{camera}_final_hdf5" / f"{name}.color.hdf5"
        write_array(hdr, np.zeros((H, W, 3), "f2"))
    return root


def write_split(path: Path) -> None:
    lines = ["scene_name,camera_name,frame_id,included_in_public_release,exclude_reason,"]
    lines[0] += "split_partition_name"
    for inner, camera, number in FRAMES:
        lines.append(f"{inner},cam_{camera},{number},True,,{SPLITS[inner]}")
        lines.append(f"{inner},cam_{camera},{number + 1},False,CONTENT FLAGGED FOR REMOVAL,")
    path.write_text("\n".join(lines) + "\n")


def write_cameras(path: Path, cameras: dict[str, np.ndarray]) -> None:
    names = [f"M_proj_{row}{column}" for row in range(4) for column in range(4)]
    lines = [",".join(("scene_name", "settings_output_img_height", *names))]
    for inner, projection in cameras.items():
        lines.append(",".join((inner, "768.0", *map(repr, projection.ravel().tolist()))))
    path.write_text("\n".join(lines) + "\n")


def test_frames_are_what_the_folders_the_tables_and_the_truth_say(tmp_path: Path) -> None:
    cameras = {inner: WIDE for inner, _, _ in FRAMES} | {"ai_002_003": shifted()}
    root = write_hypersim(tmp_path / "scenes", cameras)
    write_cameras(root / "metadata_camera_parameters.csv", cameras)
    write_split(tmp_path / "metadata_images_split_scene_v1.csv")
    reader = open_reader(root)
    assert reader.info.name == "hypersim"
    assert reader.ids == tuple(frame_id(seed) for seed in range(4))
    assert (len(reader.info.classes), reader.info.classes[1].name) == (40, "floor")
    for seed, (inner, _, _) in enumerate(FRAMES):
        frame, made = reader.read(frame_id(seed)), scene(seed)
        camera = frame.camera
        found = (camera.fx, camera.fy, camera.cx, camera.cy)
        assert found == pytest.approx(intrinsics(cameras[inner]), abs=1e-9)
        assert reader.group(frame_id(seed)) == inner
        assert reader.fixed_split(frame_id(seed)) == SPLITS[inner]
        # Half floats have 11 bits.
        np.testing.assert_allclose(frame.depth_m, made.depth_m, rtol=2**-11)
        of = {value: 255 if raw < 0 else raw for value, raw in RAW.items()}
        np.testing.assert_array_equal(frame.label, np.vectorize(of.get)(made.label))
        assert frame.rgb is not None
        assert np.abs(frame.rgb.astype(int) - made.rgb).mean() < 2
    assert reader.info.hha_ground == "lowest"


def test_without_the_tables_the_usual_camera_is_assumed_and_that_is_said(tmp_path: Path) -> None:
    root = write_hypersim(tmp_path / "hypersim")
    with pytest.warns(UserWarning, match="official split|60 degrees wide"):
        store = nimprep.convert(root, tmp_path / "o.zarr")
    assert store.about.dataset == "hypersim"
    assert "ICCV 2021" in store.about.references[0]["citation"]
    reader = open_reader(root)
    assert {reader.fixed_split(i) for i in reader.ids} == {None}
    camera = reader.read(reader.ids[0]).camera
    found = (camera.fx, camera.fy, camera.cx, camera.cy)
    assert found == pytest.approx(intrinsics(WIDE), abs=1e-9)
    assert found[0] == pytest.approx(W / 2 / np.tan(np.radians(30)))


def test_a_tilted_image_plane_is_that_of_a_camera_along_its_normal() -> None:
    # Turned by 0.2 about x and 0.1 about y: the same rays, seen from a camera's own axes.
    a, b = 0.2, 0.1
    turn = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]]) @ np.array(
        [[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]]
    )
    projection = shifted()
    rows = projection[[0, 1, 3], :3] @ turn
    tilted = projection.copy()
    # Whatever the scale of w is.
    tilted[[0, 1, 3], :3] = 1.7 * rows
    found = camera_of_projection(tilted, H, W)
    assert isinstance(found, dict)
    named = tuple(found[n] for n in ("fx", "fy", "cx", "cy"))
    assert named == pytest.approx(intrinsics(projection), abs=1e-9)
    assert (found["width"], found["height"]) == (W, H)


@pytest.mark.parametrize("scale", [1.0, -1.0, 0.3])
def test_a_projection_is_taken_as_it_is_whatever_its_scale(scale: float) -> None:
    found = camera_of_projection(WIDE * scale, H, W)
    assert isinstance(found, dict)
    assert found["fx"] == pytest.approx(found["fy"]) == pytest.approx(intrinsics(WIDE)[0])


def test_projections_that_no_camera_has_are_bad_frames(tmp_path: Path) -> None:
    root = write_hypersim(tmp_path / "hypersim")
    skewed, flat = WIDE.copy(), WIDE.copy()
    skewed[0, 1], flat[3, 2] = 0.3, 0
    cameras = {"ai_001_001": WIDE, "ai_002_003": skewed, "ai_003_010": flat * np.nan}
    write_cameras(root / "metadata_camera_parameters.csv", cameras)
    reader = open_reader(root)
    assert reader.read(frame_id(0)).depth_m is not None
    with pytest.raises(DecodeError, match=r"expected the camera of frame .*rows are moved by"):
        reader.read(frame_id(2))
    with pytest.raises(DecodeError, match=r"expected the camera of frame .*no projection"):
        reader.read(frame_id(3))
    assert isinstance(camera_of_projection(flat, H, W), str)
    write_cameras(root / "metadata_camera_parameters.csv", {"ai_001_001": WIDE})
    with pytest.raises(DecodeError, match=r"parameters\.csv: expected the camera of frame 'ai_003"):
        open_reader(root).read(frame_id(3))
    given = open_reader(root, ReaderOptions(camera=(30, 30, 17, 11)))
    assert given.read(frame_id(3)).camera.fx == 30


def test_train_ids_are_the_classes_from_0(tmp_path: Path) -> None:
    root = write_hypersim(tmp_path / "hypersim")
    label = open_reader(root, ReaderOptions(label_set="train-ids")).read(frame_id(0)).label
    assert {*np.unique(label)} == {0, 1, 39, 255}


def test_the_tables_may_lie_elsewhere(tmp_path: Path) -> None:
    root = write_hypersim(tmp_path / "a" / "hypersim", {"ai_002_003": shifted()})
    tables = tmp_path / "tables"
    tables.mkdir()
    with pytest.raises(LayoutError, match=r"split_scene_v1\.csv.*--lists"):
        open_reader(root, ReaderOptions(lists=tables))
    write_split(tables / "metadata_images_split_scene_v1.csv")
    write_cameras(tables / "metadata_camera_parameters.csv", {"ai_002_003": shifted()})
    for lists in (tables, tables / "metadata_images_split_scene_v1.csv"):
        reader = open_reader(root, ReaderOptions(lists=lists))
        assert reader.fixed_split(frame_id(2)) == "val"
        assert reader.read(frame_id(2)).camera.fx == W
    (tables / "metadata_images_split_scene_v1.csv").write_text("scene,split\na,b\n")
    with pytest.raises(LayoutError, match="expected a table with the columns scene_name"):
        open_reader(root, ReaderOptions(lists=tables))


def test_scenes_may_lie_in_folders_of_the_repository(tmp_path: Path) -> None:
    scenes = write_hypersim(tmp_path / "evermotion_dataset" / "scenes")
    (scenes.parent / "analysis").mkdir()
    write_split(scenes.parent / "analysis" / "metadata_images_split_scene_v1.csv")
    for root in (tmp_path, scenes.parent, scenes):
        assert open_reader(root).fixed_split(frame_id(3)) == "test"


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ("*.depth_meters.hdf5", "expected depth files .*unpack the scenes' zip files"),
        ("*.semantic.hdf5", "expected label files .*unpack the scenes' zip files.*--no-labels"),
        ("*.tonemap.jpg", "for hypersim it lacks .*tonemap.*scene_cam_XX_final_preview, there"),
    ],
)
def test_a_part_that_is_not_there_is_named(tmp_path: Path, pattern: str, said: str) -> None:
    root = write_hypersim(tmp_path / "hypersim")
    for path in sorted(root.rglob(pattern)):
        path.unlink()
    with pytest.raises(LayoutError, match=said):
        open_reader(root)


def test_a_wrong_folder_is_answered_with_the_right_one(tmp_path: Path) -> None:
    root = write_hypersim(tmp_path / "a" / "hypersim")
    for folder in (root.parent, root / "ai_001_001", root / "ai_001_001" / "images"):
        with pytest.raises(LayoutError, match=f"did you mean {root}\\?"):
            open_reader(folder)
    shutil.rmtree(root / "ai_001_001")
    assert open_reader(root).ids == (frame_id(2), frame_id(3))


def test_inspect_names_it(tmp_path: Path) -> None:
    root = write_hypersim(tmp_path / "hypersim")
    assert inspect_source(root).reader == recognised(root).reader == "hypersim"


def test_a_field_of_view_is_a_camera_of_any_description() -> None:
    document = {"format": "nimprep-folder", "version": "1.1", "name": "a", "rgb": "{id}.png"}
    made = description_from_document({**document, "camera": {"fov_deg": 90}}, "d.json")
    assert made.camera is not None
    assert made.camera.fov_deg == 90
    for wrong in (0, 180, "90"):
        with pytest.raises(LayoutError, match="camera"):
            description_from_document({**document, "camera": {"fov_deg": wrong}}, "d.json")
