import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from nimprep import convert
from nimprep.errors import DecodeError, LayoutError, OptionError
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.base import Reader
from nimprep.readers.matching import files_by_id, group_of
from tests.fakes import NYU_LIKE, depth_image, write_gmrp, write_nyu_like, write_png

GMRP_DESCRIBED = {
    "format": "nimprep-folder",
    "version": "1.0",
    "name": "gmrp",
    "rgb": "rgb/{id}.png",
    "depth": {"files": "depth_u16/{id}.png", "scale_m": 0.001, "invalid": [0, 65535]},
    "label": {"files": "label/{id}.png"},
    "classes": [
        {"id": 0, "name": "background", "color": [0, 0, 0]},
        {"id": 1, "name": "drivable area", "color": [0, 200, 0]},
        {"id": 2, "name": "road anomaly", "color": [220, 0, 0]},
    ],
}


def described(root: Path, description: Path) -> Reader:
    return open_reader(root, options=ReaderOptions(description=description))


def nyu_like(tmp_path: Path, **changes: object) -> Reader:
    return described(*write_nyu_like(tmp_path / "nyu", **changes))


def test_gmrp_described_reads_as_the_reader_gmrp_reads_it(tmp_path: Path) -> None:
    root = write_gmrp(tmp_path / "gmrp")
    path = tmp_path / "gmrp.json"
    path.write_text(json.dumps(GMRP_DESCRIBED))
    ours, theirs = described(root, path), open_reader(root, ReaderOptions(reader="gmrp"))
    assert ours.ids == theirs.ids
    assert ours.info == theirs.info
    for frame_id in ours.ids:
        a, b = ours.read(frame_id), theirs.read(frame_id)
        assert a.camera == b.camera
        for name in ("rgb", "depth_m", "label"):
            assert np.array_equal(getattr(a, name), getattr(b, name))


def test_a_nyu_like_dataset_has_its_unit_camera_labels_and_scenes(tmp_path: Path) -> None:
    reader = nyu_like(tmp_path)
    assert reader.ids == ("kitchen/0", "kitchen/1", "office/0", "office/1")
    assert reader.group("office/1") == "office"
    frame = reader.read("kitchen/1")
    raw = depth_image(7) * np.uint16(5)
    assert frame.depth_m is not None
    assert np.array_equal(frame.depth_m, raw / np.float32(10000))
    assert (frame.camera.cx, frame.camera.cy) == (16, 12)
    assert frame.label is not None
    assert frame.label[0, 0] == 255
    assert frame.label[4, 0] == 0
    assert frame.label[-1, 0] == 1


def test_a_label_the_map_does_not_name_is_an_error_without_a_default(tmp_path: Path) -> None:
    label = {"files": "label/{id}.png", "map": {"40": 1, "300": 255}}
    with pytest.raises(DecodeError, match="found 7"):
        nyu_like(tmp_path, label=label).read("kitchen/0")


def test_labels_can_be_told_by_colour(tmp_path: Path) -> None:
    root, path = write_nyu_like(
        tmp_path / "nyu", label={"files": "label/{id}.png", "map": {"#ff0000": 1, "#000000": 0}}
    )
    image = np.zeros((24, 32, 3), np.uint8)
    image[:5, :, 0] = 255
    for frame_id in ("kitchen/0", "kitchen/1", "office/0", "office/1"):
        write_png(root / "label" / f"{frame_id}.png", image)
    label = described(root, path).read("office/0").label
    assert label is not None
    assert np.array_equal(label, (np.arange(24) < 5)[:, None] * np.ones((1, 32), int))


def test_depth_can_be_a_numpy_array_in_metres(tmp_path: Path) -> None:
    depth = {"files": "metres/{id}.npy", "scale_m": 1.0}
    root, path = write_nyu_like(tmp_path / "nyu", depth=depth)
    for frame_id in ("kitchen/0", "kitchen/1", "office/0", "office/1"):
        array = np.full((24, 32), 2.5, np.float32)
        array[0, 0] = np.nan
        (root / "metres" / frame_id).parent.mkdir(parents=True, exist_ok=True)
        np.save(root / "metres" / f"{frame_id}.npy", array)
    reader = described(root, path)
    depth_m = reader.read("office/0").depth_m
    assert reader.shape("office/0") == (24, 32)
    assert depth_m is not None
    assert depth_m[0, 0] == 0
    assert depth_m[1, 1] == 2.5


def test_metres_in_a_float_file_read_as_millimetres_are_refused(tmp_path: Path) -> None:
    depth = {"files": "metres/{id}.npy", "scale_m": 0.001}
    root, path = write_nyu_like(tmp_path / "nyu", depth=depth)
    for frame_id in ("kitchen/0", "kitchen/1", "office/0", "office/1"):
        (root / "metres" / frame_id).parent.mkdir(parents=True, exist_ok=True)
        np.save(root / "metres" / f"{frame_id}.npy", np.full((24, 32), 2.5, np.float32))
    with pytest.raises(DecodeError, match=r"found 0\.0025 m.*--depth-scale"):
        described(root, path).read("kitchen/0")


def with_float_depth(tmp_path: Path, array: np.ndarray, suffix: str, scale_m: float) -> Reader:
    """Return a reader of frames whose depth is this array in a file of floats."""
    depth = {"files": f"m/{{id}}{suffix}", "scale_m": scale_m, "invalid": [-9999]}
    root, path = write_nyu_like(tmp_path / "nyu", depth=depth)
    for frame_id in ("kitchen/0", "kitchen/1", "office/0", "office/1"):
        file = root / "m" / f"{frame_id}{suffix}"
        file.parent.mkdir(parents=True, exist_ok=True)
        if suffix == ".npy":
            np.save(file, array)
        else:
            assert cv2.imwrite(str(file), array)
    return described(root, path)


@pytest.mark.parametrize("scale_m", [1.0, 0.001, 0.0123])
@pytest.mark.parametrize(
    ("suffix", "dtype"),
    [
        *((".npy", dtype) for dtype in ("<f2", "<f4", ">f4", "<f8", ">f8")),
        *((".tiff", dtype) for dtype in ("<f4", "<f8")),
        (".pfm", "<f4"),
    ],
)
def test_nan_infinity_and_what_is_far_too_small_are_no_depth(
    tmp_path: Path, suffix: str, dtype: str, scale_m: float
) -> None:
    metres = np.full((24, 32), 2.5)
    none = [0.0, -0.0, np.nan, -np.nan, np.inf, -np.inf, 1e-20, 0.00005, -9999 * scale_m]
    metres[3, : len(none)] = none
    with np.errstate(over="ignore"):
        reader = with_float_depth(tmp_path, (metres / scale_m).astype(dtype), suffix, scale_m)
    depth_m = reader.read("kitchen/0").depth_m
    assert depth_m is not None
    assert not depth_m[3, : len(none)].any()
    assert np.count_nonzero(depth_m) == depth_m.size - len(none)
    assert np.allclose(depth_m[depth_m > 0], 2.5, rtol=2e-3 if dtype == "<f2" else 1e-6)


@pytest.mark.parametrize("value", [-1.0, -1e-30, -3e38])
def test_a_negative_depth_is_refused_by_its_pixel(tmp_path: Path, value: float) -> None:
    array = np.full((24, 32), 2.5)
    array[3, 5], array[4, 1] = value, value
    reader = with_float_depth(tmp_path, array, ".npy", 1.0)
    expected = rf"0\.npy: .*>= 0, found {value:g} at pixel \(u, v\) = \(5, 3\), one of 2 negative"
    with pytest.raises(DecodeError, match=expected.replace("+", r"\+")):
        reader.read("kitchen/0")


def test_one_camera_can_stand_in_the_description(tmp_path: Path) -> None:
    reader = nyu_like(tmp_path, camera={"fx": 9, "fy": 9, "cx": 1, "cy": 2})
    assert reader.read("kitchen/0").camera.fx == 9
    assert reader.info.calibration == "file"


def test_without_a_camera_the_nominal_one_is_taken(tmp_path: Path) -> None:
    root, path = write_nyu_like(tmp_path / "nyu")
    path.write_text(json.dumps({k: v for k, v in NYU_LIKE.items() if k != "camera"}))
    assert described(root, path).info.calibration == "nominal"


def test_a_frame_without_its_camera_file_is_a_bad_frame(tmp_path: Path) -> None:
    root, path = write_nyu_like(tmp_path / "nyu")
    (root / "camera" / "office" / "1.json").unlink()
    reader = described(root, path)
    assert "office/1" in reader.ids
    for ask in (reader.sources, reader.shape, reader.read):
        with pytest.raises(DecodeError, match=r"expected a camera of frame 'office/1' like 'cam"):
            ask("office/1")
    store = convert(root, tmp_path / "s.zarr", description=path, on_error="skip")
    assert store.ids == ("kitchen/0", "kitchen/1", "office/0")
    assert [frame["id"] for frame in store.about.skipped] == ["office/1"]


def test_a_data_set_without_any_camera_file_is_refused(tmp_path: Path) -> None:
    root, path = write_nyu_like(tmp_path / "nyu")
    for file in (root / "camera").rglob("*.json"):
        file.rename(file.with_suffix(".other"))
    with pytest.raises(LayoutError, match="expected a camera of every frame, found none of any"):
        described(root, path)


def test_depth_need_not_be_there_where_nothing_of_it_is_stored(tmp_path: Path) -> None:
    root, path = write_nyu_like(tmp_path / "nyu")
    shutil.rmtree(root / "depth")
    options = {"description": path, "modalities": ("rgb", "label")}
    assert len(convert(root, tmp_path / "s.zarr", **options)) == 4
    gmrp = write_gmrp(tmp_path / "gmrp")
    shutil.rmtree(gmrp / "depth_u16")
    with pytest.warns(UserWarning, match="no calibration"):
        store = convert(gmrp, tmp_path / "g.zarr", modalities=("rgb",))
    assert store.modalities == ("rgb",)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rgb": "/etc/{id}.png"}, "rgb"),
        ({"rgb": "color/x.png"}, "color/x.png"),
        ({"rgb": "../{id}.png"}, "below the folder"),
        ({"depth": {"files": "depth/{id}.png"}}, "scale_m"),
        ({"classes": []}, "classes"),
        ({"name": ""}, "name"),
        ({"label": {"files": "label/{id}.png", "map": {"40": 3}}}, "found 3"),
        ({"colour": 1}, "colour"),
        ({"rgb": "missing/{id}.png"}, "missing"),
        ({"rgb": "color/{id}.jpg"}, "expected rgb files"),
    ],
)
def test_a_description_that_cannot_be_is_refused(
    tmp_path: Path, change: dict[str, object], words: str
) -> None:
    with pytest.raises(LayoutError, match=words):
        nyu_like(tmp_path, **change)


def test_a_description_goes_with_the_reader_folder_alone(tmp_path: Path) -> None:
    root, path = write_nyu_like(tmp_path / "nyu")
    with pytest.raises(OptionError, match="--description: expected options of the reader gmrp"):
        open_reader(root, ReaderOptions(reader="gmrp", description=path))
    with pytest.raises(OptionError, match="--description: expected it with the reader folder"):
        open_reader(root, ReaderOptions(reader="folder"))


def test_stars_stay_in_a_folder_and_double_stars_cross(tmp_path: Path) -> None:
    for name in ("a/x1.png", "b/x2.png", "b/c/x3.png", ".hidden/x4.png"):
        write_png(tmp_path / name, np.zeros((2, 2), np.uint8))
    assert set(files_by_id(tmp_path, "*/x{id}.png")) == {"1", "2"}
    assert set(files_by_id(tmp_path, "**/x{id}.png")) == {"1", "2", "3"}
    assert set(files_by_id(tmp_path, "{id}.png")) == {"a/x1", "b/x2", "b/c/x3"}


def test_two_files_of_one_id_are_refused(tmp_path: Path) -> None:
    for name in ("a/1.png", "b/1.png"):
        write_png(tmp_path / name, np.zeros((2, 2), np.uint8))
    with pytest.raises(LayoutError, match="one file per id '1'"):
        files_by_id(tmp_path, "*/{id}.png")


@pytest.mark.parametrize(
    ("frame_id", "pattern", "group"),
    [
        ("kitchen/0", "{group}/*", "kitchen"),
        ("um_000001", "{group}_*", "um"),
        ("a_b_1", "{group}_*", "a"),
        ("a_b_1", "{group}_?", "a_b"),
        ("nothing", "{group}_*", ""),
        ("nothing", None, ""),
    ],
)
def test_a_group_is_what_its_pattern_says(frame_id: str, pattern: str | None, group: str) -> None:
    assert group_of(frame_id, pattern) == group
