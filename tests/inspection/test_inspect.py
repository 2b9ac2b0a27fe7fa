"""Archives, recordings, stores, folders one too deep, and hostile ones."""

from __future__ import annotations

import json
import os
import sqlite3
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import LayoutError
from nimprep.inspection import survey
from nimprep.inspection.inspection import inspect_source
from nimprep.readers import open_reader
from nimprep.readers.description_file import description_from_document
from nimprep.readers.folder import FolderReader
from nimprep.schema import schema_problems
from tests.fakes import write_gmrp, write_png
from tests.inspection import scenes


def test_a_layout_with_a_reader_is_named_with_the_command(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "gmrp")
    found = inspect_source(raw)
    assert (found.kind, found.reader) == ("reader", "gmrp")
    assert found.next_steps == [f"nimprep convert {raw} OUT.zarr"]


def test_a_folder_of_rgb_alone_is_no_gmrp(tmp_path: Path) -> None:
    scenes.icl_nuim(tmp_path / "raw")
    assert inspect_source(tmp_path / "raw").reader is None


@pytest.mark.parametrize("inner", ["gmrp", "data/gmrp"])
def test_one_folder_too_high_asks_whether_the_inner_one_was_meant(
    tmp_path: Path, inner: str
) -> None:
    write_gmrp(tmp_path / "raw" / inner)
    meant = tmp_path / "raw" / inner
    assert f"did you mean {meant}?" in inspect_source(tmp_path / "raw").notes
    with pytest.raises(LayoutError, match=f"did you mean {meant}"):
        open_reader(tmp_path / "raw")


def test_one_folder_too_deep_asks_whether_the_outer_one_was_meant(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "gmrp")
    assert f"did you mean {raw}?" in inspect_source(raw / "label").notes


def test_an_archive_says_what_is_in_it(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "gmrp")
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for path in sorted(raw.rglob("*.png")):
            archive.write(path, path.relative_to(tmp_path))
    with tarfile.open(tmp_path / "b.tar.gz", "w:gz") as packed:
        packed.add(raw, "gmrp")
    for name in ("a.zip", "b.tar.gz"):
        found = inspect_source(tmp_path / name)
        assert found.kind == "archive"
        assert "GMRP's layout" in found.what or name == "b.tar.gz"
        assert any(entry.endswith(".png") for entry in found.holdings[0].names)
        assert "unpack" in found.next_steps[0]


def test_a_folder_of_archives_names_them(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "depth.zip", "w") as archive:
        archive.writestr("depth/0.png", b"")
    found = inspect_source(tmp_path)
    assert (found.kind, found.holdings[0].names) == ("archive", ("depth/0.png",))


RECORDINGS = {
    "a.bag": b"#ROSBAG V2.0\n" + b"\0" * 40 + b"topic=/camera/depth" + b"\x04\0\0\0",
    "b.mcap": b"\x89MCAP0\r\n" + b"\x0d\0\0\0/camera/depth\x03\0\0\0cdr",
    "c.svo2": b"something",
    "d.mp4": b"\0\0\0\x20ftypisom" + b"\0" * 20,
    "e.avi": b"RIFF\0\0\0\0AVI LIST",
    "f.mkv": b"\x1a\x45\xdf\xa3" + b"\0" * 20,
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_recordings_are_told_by_their_signatures(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(RECORDINGS[name])
    found = inspect_source(tmp_path / name)
    assert found.kind == "recording"
    assert "export" in found.next_steps[0]
    if name in ("a.bag", "b.mcap"):
        assert found.holdings[0].names == ("/camera/depth",)
    assert inspect_source(tmp_path).kind == "recording"
    assert not schema_problems(found.to_dict(), "inspection")


def test_topics_of_a_database_are_read_and_nothing_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE topics (name TEXT)")
        database.execute("INSERT INTO topics VALUES ('/camera/color'), ('/camera/depth')")
    database.close()
    before = sorted(tmp_path.iterdir()), path.read_bytes()
    found = inspect_source(path)
    assert (found.kind, found.holdings[0].names) == (
        "recording",
        ("/camera/color", "/camera/depth"),
    )
    assert (sorted(tmp_path.iterdir()), path.read_bytes()) == before


@pytest.mark.parametrize(
    ("start", "what"),
    [
        (b"\0\0\0\x18ftypheic", "HEIC"),
        (b"GIF89a", "GIF"),
        (b"7z\xbc\xaf\x27\x1c", "7z"),
        (b"\x89HDF\r\n\x1a\n", "HDF5"),
        (b"MATLAB 5.0 MAT-file", "MATLAB v5"),
    ],
)
def test_other_formats_are_named(tmp_path: Path, start: bytes, what: str) -> None:
    (tmp_path / "x.data").write_bytes(start + b"\0" * 100)
    assert what in inspect_source(tmp_path / "x.data").what


def test_a_store_is_called_one(tmp_path: Path) -> None:
    nimprep.convert(write_gmrp(tmp_path / "raw"), tmp_path / "s.zarr", camera=(30, 30, 16, 12))
    found = inspect_source(tmp_path / "s.zarr")
    assert (found.kind, found.next_steps) == ("store", [f"nimprep info {tmp_path / 's.zarr'}"])
    assert "s.zarr is a store" in " ".join(inspect_source(tmp_path).notes)


def test_nothing_is_one_line_and_exit_1(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for name in ("empty", "missing"):
        result = CliRunner().invoke(main, ["inspect", str(tmp_path / name)])
        assert result.exit_code == 1
        assert result.stderr.count("\n") == 1
        assert result.stderr.startswith("error: ")


def test_a_description_is_written_once_and_converts(tmp_path: Path) -> None:
    raw, file, out = tmp_path / "raw", tmp_path / "d.json", tmp_path / "out.zarr"
    scenes.nameless(raw)
    runner = CliRunner()
    result = runner.invoke(main, ["inspect", str(raw), "--write", str(file)])
    assert result.exit_code == 0, result.output
    assert f"nimprep convert {raw} OUT.zarr --description {file}" in result.output
    again = runner.invoke(main, ["inspect", str(raw), "--write", str(file)])
    assert again.exit_code == 1
    given = ["--description", str(file), "--intrinsics", "80,80,47.5,20", "--quiet"]
    result = runner.invoke(main, ["convert", str(raw), str(out), *given])
    assert result.exit_code == 0, result.output
    store = nimprep.open_store(out)
    for k in range(scenes.FRAMES):
        depth = store[store.ids.index(str(k))].depth_m
        assert depth is not None
        np.testing.assert_allclose(depth, scenes.street(k)[1], atol=1 / 256 + 0.001)


def test_the_same_object_is_printed_as_json(tmp_path: Path) -> None:
    scenes.icl_nuim(tmp_path / "raw")
    result = CliRunner().invoke(main, ["inspect", str(tmp_path / "raw"), "--json"])
    assert json.loads(result.stdout) == inspect_source(tmp_path / "raw").to_dict()


def test_bad_files_are_a_line_each(tmp_path: Path) -> None:
    scenes.icl_nuim(tmp_path)
    (tmp_path / "rgb" / "1.png").write_bytes(b"\x89PNG\r\n\x1a\n broken")
    (tmp_path / "depth" / "0.png").write_bytes(b"")
    (tmp_path / "depth" / "loop").symlink_to(tmp_path)
    (tmp_path / "rgb" / "gone.png").symlink_to(tmp_path / "nowhere.png")
    os.mkfifo(tmp_path / "rgb" / "pipe.png")
    found = inspect_source(tmp_path).to_dict()
    said = " ".join(found["problems"])
    for name in ("rgb/1.png", "depth/0.png", "depth/loop", "rgb/gone.png"):
        assert name in said
    assert found["depth"][0]["encodings"][0]["depth"]["scale_m"] == 1 / 5000


def test_links_to_folders_are_followed_once(tmp_path: Path) -> None:
    scenes.icl_nuim(tmp_path / "a")
    (tmp_path / "b").mkdir()
    for name in ("rgb", "depth"):
        (tmp_path / "b" / name).symlink_to(tmp_path / "a" / name)
    (tmp_path / "b" / "again").symlink_to(tmp_path / "a" / "rgb")
    counts = {
        row["files"]: row["count"] for row in inspect_source(tmp_path / "b").to_dict()["patterns"]
    }
    assert sum(counts.values()) == 2 * scenes.FRAMES


def test_beyond_a_number_of_files_it_says_that_there_are_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for k in range(30):
        write_png(tmp_path / f"rgb/{k:03d}.png", np.full((4, 4, 3), k, np.uint8))
    monkeypatch.setattr(survey, "MAX_FILES", 20)
    found = inspect_source(tmp_path).to_dict()
    assert found["sampled"]
    assert found["files"] == 20


def test_a_folder_that_only_looks_like_a_layout_leads_to_inspect(tmp_path: Path) -> None:
    scenes.icl_nuim(tmp_path / "raw")
    result = CliRunner().invoke(main, ["convert", str(tmp_path / "raw"), str(tmp_path / "s.zarr")])
    assert result.exit_code == 1
    assert f"nimprep inspect {tmp_path / 'raw'} says what is there" in result.stderr


def test_scans_without_depth_images_are_said_to_be_left_out(tmp_path: Path) -> None:
    for k in range(3):
        scenes.save(tmp_path / f"sequences/00/image_2/{k:06d}.png", scenes.street(k)[0])
        scan = tmp_path / f"sequences/00/velodyne/{k:06d}.bin"
        scan.parent.mkdir(exist_ok=True)
        np.random.default_rng(k).normal(0, 8, (200, 4)).astype(np.float32).tofile(scan)
    scenes.note(tmp_path / "sequences/00/calib.txt", "P2: 80 0 47.5 0 0 80 20 0 0 0 1 0\n")
    found = inspect_source(tmp_path)
    assert "LiDAR scans are no depth images, and are left out" in found.notes
    assert found.description is not None
    assert "depth" not in found.description
    assert found.description["camera"] == "sequences/{scene}/calib.txt"


def test_a_mask_of_valid_depth_becomes_its_confidence(tmp_path: Path) -> None:
    scenes.diode(tmp_path)
    # By its own folders it is known by name.
    (tmp_path / "train").rename(tmp_path / "mine")
    found = inspect_source(tmp_path).description
    assert found is not None
    assert found["depth"]["confidence"]["files"].endswith("{id}_depth_mask.npy")


def test_folders_too_deep_and_links_to_themselves_are_a_line_each(tmp_path: Path) -> None:
    scenes.icl_nuim(tmp_path)
    deep = tmp_path.joinpath(*["d"] * 300)
    deep.mkdir(parents=True)
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    said = " ".join(inspect_source(tmp_path).to_dict()["problems"])
    assert "more than 40 deep" in said
    assert "loop" in said


def test_lists_that_name_every_frame_leave_none_over(tmp_path: Path) -> None:
    for k in range(4):
        scenes.save(tmp_path / f"left/left{k}.png", scenes.street(k)[0])
        scenes.save(tmp_path / f"depth/depth{k}.png", scenes.units(scenes.street(k)[1], 1000))
    scenes.note(tmp_path / "train.txt", "0\n1\n2\n")
    for names, rest in (("3\n", {}), ("", {"rest": "skip"})):
        scenes.note(tmp_path / "test.txt", names)
        found = inspect_source(tmp_path).description
        assert found is not None
        lists = {"train": "train.txt", **({"test": "test.txt"} if names else {})}
        assert found["split"] == {"lists": lists, **rest}


def test_several_endings_of_one_kind_of_image_are_one_pattern(tmp_path: Path) -> None:
    for k, ending in enumerate(("jpg", "JPG", "jpeg", "png")):
        color, depth = scenes.street(k)
        scenes.save(tmp_path / f"rgb/{k}.{ending}", color)
        scenes.save(tmp_path / f"depth/{k}.png", scenes.units(depth, 1000))
    found = inspect_source(tmp_path)
    assert found.description is not None
    assert found.description["rgb"] == "rgb/{id}.*"
    assert "the description gives 4 frames" in found.notes


def test_colour_and_depth_of_one_name_and_folder_are_two_patterns(tmp_path: Path) -> None:
    for k in range(3):
        color, depth = scenes.street(k)
        scenes.save(tmp_path / f"kitchen/{k}.jpg", color)
        scenes.save(tmp_path / f"kitchen/{k}.png", scenes.units(depth, 1000))
    found = inspect_source(tmp_path).description
    assert found is not None
    assert found["rgb"].endswith("{id}.jpg")
    assert found["depth"]["files"].endswith("{id}.png")


def test_a_description_that_lies_there_is_named_and_is_no_camera(tmp_path: Path) -> None:
    scenes.icl_nuim(tmp_path)
    camera = {"fx": 80, "fy": 80, "cx": 47, "cy": 20}
    document = {"format": "nimprep-folder", "version": "1.0", "name": "x", "camera": camera}
    scenes.note(tmp_path / "d.json", json.dumps(document))
    found = inspect_source(tmp_path)
    assert "d.json is a description already" in found.notes
    assert found.to_dict()["cameras"] == []


def test_arrays_of_hdf5_files_of_a_frame_each(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    for k in range(3):
        color, depth = scenes.street(k, closer=4)
        (tmp_path / "train").mkdir(exist_ok=True)
        with h5py.File(tmp_path / f"train/{k:05d}.h5", "w") as file:
            file["rgb"] = color.transpose(2, 0, 1)
            file["depth"] = depth
    found = inspect_source(tmp_path).description
    assert found is not None
    assert found["rgb"] == {"files": "{split}/{id}.h5", "key": "rgb", "axes": "CHW"}
    assert found["depth"] == {"files": "{split}/{id}.h5", "key": "depth", "scale_m": 1.0}
    reader = FolderReader(tmp_path, description_from_document(found, "d"))
    read = reader.read("train/00001").depth_m
    assert read is not None
    np.testing.assert_allclose(read, scenes.street(1, closer=4)[1], atol=1e-5)


CAMERAS = {
    "camera.yaml": "image_width: 96\nimage_height: 64\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
    "  data: [80.0, 0, 47.5, 0, 80.0, 20.0, 0, 0, 1]\n",
    "camera.json": '{"intrinsic_matrix": [80.0, 0, 0, 0, 80.0, 0, 47.5, 20.0, 1]}',
    "transforms.json": '{"fl_x": 80, "fl_y": 80, "cx": 47.5, "cy": 20, "w": 96, "h": 64}',
    "cameras.txt": "# Camera list with one line of data per camera:\n"
    "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 PINHOLE 96 64 80 80 48 20.5\n",
    "intrinsics.txt": "80 0 47.5\n0 80 20\n0 0 1\n",
    "settings.yaml": "%YAML:1.0\nCamera.fx: 80.0\nCamera.fy: 80.0\nCamera.cx: 47.5\n"
    "Camera.cy: 20.0\nDepthMapFactor: 1000.0\n",
    "calib.txt": "P0: 1 0 1 0 0 1 1 0 0 0 1 0\nP2: 80 0 47.5 0 0 80 20 0 0 0 1 0\n",
}


@pytest.mark.parametrize("name", CAMERAS)
def test_camera_files_are_told_by_what_is_in_them_and_read_by_the_description(
    tmp_path: Path, name: str
) -> None:
    for k in range(2):
        color, depth = scenes.street(k)
        scenes.save(tmp_path / f"left/{k}.png", color)
        scenes.save(tmp_path / f"depth/{k}.png", scenes.units(depth, 1000))
    scenes.note(tmp_path / name, CAMERAS[name])
    found = inspect_source(tmp_path)
    assert found.description is not None
    reader = FolderReader(tmp_path, description_from_document(found.description, "d"))
    camera = reader.read("0").camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (80, 80, 47.5, 20)
