"""Export as PNGs gives GMRP's raw layout back: what was exported converts to the same store."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import CameraError, StoreError
from nimprep.export import export_frames
from nimprep.export.png import group_pattern
from nimprep.schema import schema_problems
from nimprep.store.reader import Store
from tests.fakes import depth_image, write_gmrp, write_nyu_like, write_png

CAMERA = (30.25, 31.5, 15.125, 1 / 3)


def run(*arguments: object) -> None:
    assert CliRunner().invoke(main, [str(a) for a in arguments]).exit_code == 0


def assert_same(a: Store, b: Store) -> None:
    """Compare everything that an exported folder can hold, and what is derived from it."""
    assert a.ids == b.ids
    assert a.classes == b.classes
    assert a.splits == b.splits
    assert a.tables.group == b.tables.group
    for name in ("image_size", "intrinsics", "baseline", "cam_to_road"):
        np.testing.assert_array_equal(getattr(a.tables, name), getattr(b.tables, name))
    assert a.modalities == b.modalities
    for modality in a.modalities:
        for number in range(len(a)):
            images = a.arrays[modality].read(number), b.arrays[modality].read(number)
            np.testing.assert_array_equal(*images, err_msg=f"{modality} of frame {number}")


def convert_back(folder: Path, target: Path) -> Store:
    files = {"description": folder / "description.json", "split_file": folder / "split.json"}
    return nimprep.convert(folder, target, **files)


def test_a_gmrp_store_converts_back_from_its_folders_alone(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "raw")
    store = nimprep.convert(raw, tmp_path / "s.zarr", camera=CAMERA)
    assert export_frames(store, tmp_path / "out") == list(store.ids)
    # As GMRP itself would be converted: no description, no camera given, no warning.
    again = nimprep.convert(tmp_path / "out", tmp_path / "again.zarr")
    assert_same(store, again)
    assert_same(store, convert_back(tmp_path / "out", tmp_path / "described.zarr"))


def test_the_files_are_the_raw_datasets_pixels(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "raw")
    store = nimprep.convert(raw, tmp_path / "s.zarr", camera=CAMERA)
    export_frames(store, tmp_path / "out")
    for folder in ("rgb", "depth_u16", "label"):
        names = sorted(path.name for path in (raw / folder).iterdir())
        assert sorted(path.name for path in (tmp_path / "out" / folder).iterdir()) == names
        for name in names:
            made, given = (
                cv2.imread(str(root / folder / name), cv2.IMREAD_UNCHANGED)
                for root in (tmp_path / "out", raw)
            )
            assert made.dtype == given.dtype
            if folder == "depth_u16":
                # 65535 means none in GMRP; a store has one value for that, 0.
                assert (given == 65535).sum() == 1
                given[given == 65535] = 0
            np.testing.assert_array_equal(made, given)


def test_a_cropped_store_keeps_its_camera(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "raw", frames=3)
    with pytest.warns(UserWarning, match="nominal"):
        store = nimprep.convert(raw, tmp_path / "s.zarr", crop=(3, 0, 2, 5))
    export_frames(store, tmp_path / "out")
    camera = json.loads((tmp_path / "out" / "camera.json").read_text())
    assert (camera["width"], camera["height"]) == (25, 21)
    # Which was nominal, and does not pass for a calibration.
    assert camera["origin"] == "nominal"
    assert_same(store, nimprep.convert(tmp_path / "out", tmp_path / "again.zarr"))


def write_mixed(root: Path, cameras: bool) -> Path:
    """Write frames of three sizes in scenes, with a camera each or one for all."""
    for number, (scene, size) in enumerate(
        (("um", (20, 40)), ("um", (24, 32)), ("uu", (30, 28)), ("umm", (20, 40)))
    ):
        name = f"training/{scene}_{number:06d}"
        rng = np.random.default_rng(number)
        write_png(root / "rgb" / f"{name}.png", rng.integers(0, 256, (*size, 3), dtype=np.uint8))
        write_png(root / "depth" / f"{name}.png", depth_image(number, size))
        write_png(root / "label" / f"{name}.png", rng.choice([0, 3, 255], size).astype(np.uint8))
        (root / "cam" / "training").mkdir(parents=True, exist_ok=True)
        fx = 30 + (number if cameras else 0)
        document = {"fx": fx, "fy": 31, "cx": 16.1, "cy": 11, "baseline_m": 0.54}
        (root / "cam" / f"{name}.json").write_text(json.dumps(document))
    description = {
        "format": "nimprep-folder",
        "version": "1.0",
        "name": "mixed",
        "rgb": "rgb/{id}.png",
        "depth": {"files": "depth/{id}.png", "scale_m": 0.001, "invalid": [0, 65535]},
        "label": {"files": "label/{id}.png"},
        "classes": [
            {"id": 0, "name": "not road", "color": [1, 2, 3]},
            {"id": 3, "name": "a <road> & more", "color": [4, 5, 6]},
        ],
        "camera": "cam/{id}.json",
        "group": "training/{group}_*",
    }
    path = root.parent / "mixed.json"
    path.write_text(json.dumps(description))
    return path


@pytest.mark.parametrize("cameras", [True, False])
def test_frames_of_several_sizes_cameras_classes_and_scenes_convert_back(
    tmp_path: Path, cameras: bool
) -> None:
    description = write_mixed(tmp_path / "raw", cameras)
    store = nimprep.convert(tmp_path / "raw", tmp_path / "s.zarr", description=description)
    assert len({tuple(size) for size in store.tables.image_size}) == 3
    assert set(store.tables.group) == {"um", "uu", "umm"}
    export_frames(store, tmp_path / "out")
    for number, frame_id in enumerate(store.ids):
        image = cv2.imread(str(tmp_path / "out" / "label" / f"{frame_id}.png"), -1)
        assert image.shape == tuple(store.tables.image_size[number])
    assert (tmp_path / "out" / "camera.json").is_file() is not cameras
    assert (tmp_path / "out" / "camera" / "training" / "um_000000.json").is_file() is cameras
    assert_same(store, convert_back(tmp_path / "out", tmp_path / "again.zarr"))


def test_some_frames_convert_back_to_these_frames(tmp_path: Path) -> None:
    raw, description = write_nyu_like(tmp_path / "raw")
    options = {"description": description, "split_by": "frame"}
    store = nimprep.convert(raw, tmp_path / "s.zarr", **options)
    assert export_frames(store, tmp_path / "out", frames=["kitchen/1", "2:4"]) == [
        "kitchen/1",
        "office/0",
        "office/1",
    ]
    again = convert_back(tmp_path / "out", tmp_path / "again.zarr")
    assert again.ids == store.ids[1:]
    assert again.tables.group == ("kitchen", "office", "office")
    assert again.splits == {i: store.splits[i] for i in again.ids}
    np.testing.assert_array_equal(again.arrays["depth"].read(1), store.arrays["depth"].read(2))


def test_the_records_fit_their_schemas(tmp_path: Path) -> None:
    description = write_mixed(tmp_path / "raw", cameras=True)
    store = nimprep.convert(tmp_path / "raw", tmp_path / "s.zarr", description=description)
    export_frames(store, tmp_path / "out")
    records = {
        "folder": "description.json",
        "split": "split.json",
        "camera": "camera/training/um_000000.json",
    }
    for schema, name in records.items():
        document = json.loads((tmp_path / "out" / name).read_text())
        assert schema_problems(document, schema) == []


@pytest.mark.parametrize(
    ("groups", "pattern"),
    [
        ({"a/0": "a", "b/1": "b"}, "{group}/*"),
        ({"a/x/0": "a", "b/1": "b"}, "{group}/**"),
        ({"training/a/0": "a", "testing/b/1": "b"}, "*/{group}/*"),
        ({"training/a/x/0": "a", "testing/b/1": "b"}, "*/{group}/**"),
        ({"x/training/a/0": "a", "y/testing/b/1": "b"}, "*/*/{group}/**"),
        ({"um_0": "um", "uu_1": "uu"}, "**/{group}_*"),
        ({"t/um_0": "um", "uu_1": "uu"}, "**/{group}_*"),
        ({"a-0": "a"}, "**/{group}-*"),
        ({"a/0": "a", "b/1": ""}, None),
        ({"0": "a", "1": "b"}, None),
        ({"a/0": "", "b/1": ""}, None),
    ],
)
def test_scenes_are_described_where_one_pattern_gives_them_all(
    groups: dict[str, str], pattern: str | None
) -> None:
    assert group_pattern(groups) == pattern


@pytest.mark.parametrize("chosen", [None, ("rgb", "depth", "label", "hha", "normal")])
def test_a_dataset_known_by_name_converts_back_with_what_is_its_own(
    tmp_path: Path, chosen: tuple[str, ...] | None
) -> None:
    """Its sequences, whose it is, where HHA counts from, and a test split without depth."""
    raw = tmp_path / "raw"
    for seed, (split, town) in enumerate((("train", "a"), ("train", "b"), ("test", "c"))):
        rng = np.random.default_rng(seed)
        name = f"{split}/{town}/{seed:04d}.png"
        write_png(raw / "rgb" / name, rng.integers(0, 256, (24, 32, 3), dtype=np.uint8))
        write_png(raw / "label" / name, rng.integers(0, 2, (24, 32), dtype=np.uint8))
        if split == "train":
            write_png(raw / "depth" / name, depth_image(seed, (24, 32)))
    description = {
        "format": "nimprep-folder",
        "version": "1.1",
        "name": "made",
        "rgb": "rgb/{split}/{town}/{n}.png",
        "id": "{split}/{town}/{n}",
        "group": "{town}",
        "split": {"of": "{split}", "names": {"train": "train", "test": "test"}},
        "depth": {
            "files": "depth/{split}/{town}/{n}.png",
            "scale_m": 0.001,
            "invalid": [0, 65535],
            "missing": "split",
        },
        "label": {"files": "label/{split}/{town}/{n}.png"},
        "classes": [
            {"id": 0, "name": "other", "color": [0, 0, 0]},
            {"id": 1, "name": "road", "color": [0, 200, 0]},
        ],
        "camera": {"fx": 30, "fy": 31, "cx": 16, "cy": 2},
        "hha_ground": "lowest",
        "reference": {"title": "Made", "licence": "CC BY 4.0", "citation": "Nobody. 2020."},
    }
    (tmp_path / "made.json").write_text(json.dumps(description))
    with pytest.warns(UserWarning, match="none of the frames of split test has depth"):
        store = nimprep.convert(raw, tmp_path / "s.zarr", description=tmp_path / "made.json")
    export_frames(store, tmp_path / "out", modalities=chosen)
    document = json.loads((tmp_path / "out" / "description.json").read_text())
    assert schema_problems(document, "folder") == []
    assert not (tmp_path / "out" / "depth_u16" / "test" / "c" / "0002.png").exists()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        again = convert_back(tmp_path / "out", tmp_path / "again.zarr")
    assert_same(store, again)
    assert set(again.tables.group) == {"a", "b", "c"}
    assert again.about.references == store.about.references != []
    for name in ("hha", "normal"):
        for index in range(3):
            np.testing.assert_array_equal(
                again.arrays[name].read(index), store.arrays[name].read(index)
            )


def test_scenes_that_ids_do_not_tell_and_several_licences_are_said(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "raw", frames=3)
    store = nimprep.convert(raw, tmp_path / "s.zarr", camera=CAMERA)
    store.tables = replace(store.tables, group=("x", "y", "x"))
    store.attributes = {**store.attributes, "references": [{"title": "A"}, {"title": "B"}]}
    with (
        pytest.warns(UserWarning, match="the scenes are no part of the frames' ids"),
        pytest.warns(UserWarning, match="and these are 2: nimprep info"),
    ):
        export_frames(store, tmp_path / "out")


def test_what_a_store_lacks_is_left_out(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "raw", frames=3)
    options = {"camera": CAMERA, "modalities": ["rgb", "label"]}
    store = nimprep.convert(raw, tmp_path / "s.zarr", **options)
    export_frames(store, tmp_path / "out")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    # Without depth the folder is no dataset, so nothing describes it as one.
    assert names == {"rgb", "label", "camera.json", "split.json"}
    derived = nimprep.convert(raw, tmp_path / "n.zarr", camera=CAMERA, modalities=["normal"])
    with pytest.raises(StoreError, match=r"expected one of rgb, depth, label .* found normal"):
        export_frames(derived, tmp_path / "none")
    assert not (tmp_path / "none").exists()


TO_ROAD = [[0.0, -1.0, 0.0, 0.25], [1.0, 0.0, 0.0, 1 / 3], [0.0, 0.0, 1.0, -0.5]]


def test_the_transform_to_the_road_and_gravity_convert_back(tmp_path: Path) -> None:
    description = write_mixed(tmp_path / "raw", cameras=True)
    cameras = sorted((tmp_path / "raw" / "cam").rglob("*.json"))
    # One frame has none.
    for number, path in enumerate(cameras[1:]):
        rows = [TO_ROAD[1], [-x for x in TO_ROAD[0]], TO_ROAD[2]] if number else TO_ROAD
        path.write_text(json.dumps({**json.loads(path.read_text()), "cam_to_road": rows}))
    options = {"description": description, "modalities": ["rgb", "depth", "label", "hha"]}
    store = nimprep.convert(tmp_path / "raw", tmp_path / "s.zarr", **options)
    assert store.cam_to_road(0) is None
    np.testing.assert_array_equal(store.cam_to_road(1), TO_ROAD)
    # The road's down, in the camera frame: the second row.
    np.testing.assert_array_equal(store.tables.gravity[1], TO_ROAD[1][:3])
    np.testing.assert_array_equal(store[1].cam_to_road, TO_ROAD)
    export_frames(store, tmp_path / "out")
    schema = json.loads((tmp_path / "out" / "camera" / f"{store.ids[1]}.json").read_text())
    assert schema_problems(schema, "camera") == []
    files = {"description": tmp_path / "out" / "description.json"}
    files["split_file"] = tmp_path / "out" / "split.json"
    wanted = options["modalities"]
    again = nimprep.convert(tmp_path / "out", tmp_path / "t.zarr", modalities=wanted, **files)
    assert_same(store, again)
    np.testing.assert_array_equal(store.tables.gravity, again.tables.gravity)


@pytest.mark.parametrize(
    "given",
    [
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]],
        [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]],
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "none",
        None,
    ],
)
def test_a_transform_that_is_none_is_refused(tmp_path: Path, given: object) -> None:
    raw = write_gmrp(tmp_path / "raw")
    camera = {"fx": 30, "fy": 30, "cx": 15, "cy": 12, "cam_to_road": given}
    (raw / "camera.json").write_text(json.dumps(camera))
    with pytest.raises(CameraError, match=r"camera.json: expected .*cam_to_road"):
        nimprep.convert(raw, tmp_path / "s.zarr")


def test_real_frames_convert_back(reference_data: Path, tmp_path: Path) -> None:
    options = ("--modalities", "rgb,depth,label")
    for source in ("gmrp", "kitti_road"):
        store, out, again = (tmp_path / f"{source}{end}" for end in (".zarr", "", ".again"))
        run("convert", reference_data / source, store, *options)
        run("export", store, out, "--format", "png")
        records = ("--description", out / "description.json", "--split-file", out / "split.json")
        run("convert", out, again, *options, *records)
        assert_same(nimprep.open_store(store), nimprep.open_store(again))
