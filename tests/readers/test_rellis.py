"""RELLIS-3D: a scanner's points in an image through a lens, labels of ids with gaps, lists."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.camera import Camera
from nimprep.cli import main
from nimprep.errors import CameraError, DecodeError, LayoutError
from nimprep.inspection.inspection import inspect_source
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.description import TransformSource
from nimprep.readers.description_file import description_from_document
from nimprep.readers.distortion import Distortion
from nimprep.readers.points import transform_from_file
from nimprep.readers.undistortion import nearest_through, pixel_map
from tests.fakes import write_png
from tests.scenes import CX, CY, FX, FY, SIZE, scene

COEFFICIENTS = (-0.134313, -0.025905, 0.002181, 0.00084, 0.0)
# From the camera to the scanner, as the file has it: x forward, z up there.
Q = {"w": -0.50507811, "x": 0.51206185, "y": 0.49024953, "z": -0.49228464}
T = {"x": -0.13165462, "y": 0.03870398, "z": -0.17253834}
IDS = {7: 10, 11: 12, 23: 7, 26: 8}
NAMES = {7: "asphalt", 11: "building", 23: "sky", 26: "vehicle"}
FRAMES = [(sequence, n) for sequence in ("00000", "00003") for n in (4, 104)]


def rotation() -> npt.NDArray[np.float64]:
    """Return the matrix of Q, a column per axis: q p q* of each, by Hamilton's product."""
    q = np.array([Q[name] for name in "wxyz"]) / np.linalg.norm([*Q.values()])

    def product(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        vector = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
        return np.array([a[0] * b[0] - a[1:] @ b[1:], *vector])

    around = q * [1, -1, -1, -1]
    turned = [product(product(q, np.array([0, *axis])), around)[1:] for axis in np.eye(3)]
    return np.stack(turned, axis=1)


def scan_of(depth_m: npt.NDArray[np.float32], camera: Camera) -> npt.NDArray[np.float32]:
    """Return points that show this depth, in the scanner's frame, and others that show nothing."""
    v, u = np.nonzero(depth_m)
    z = depth_m[v, u].astype(np.float64)
    seen = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1)
    # Behind what is seen, behind the camera, and where the lens's polynomial folds back: 63 degrees
    # aside, at 2 m.
    others = [seen * 1.5, -seen, np.array([[1.95 * 2.0, 0.1, 2.0]]), np.zeros((3, 3))]
    points = np.concatenate([seen, *others])
    of_scanner = points @ rotation().T + [T[name] for name in "xyz"]
    rng = np.random.default_rng(1)
    rows = np.concatenate([of_scanner, rng.random((len(points), 1))], axis=1).astype("<f4")
    rows = rng.permutation(rows)
    rows[5] = np.nan
    return rows


def sparse(seed: int) -> npt.NDArray[np.float32]:
    depth = scene(seed).depth_m.copy()
    depth[::2], depth[:, ::3] = 0, 0
    return depth


def write_rellis(root: Path, place: str = "calibration") -> dict[str, int]:
    """Write two frames per sequence; return each frame's seed by its id."""
    seeds: dict[str, int] = {}
    for sequence, n in FRAMES:
        seed = len(seeds)
        name, folder = f"frame{n:06d}-15816246{n:02d}_149", root / sequence
        seeds[f"{sequence}/{name}"] = seed
        made = scene(seed)
        label = np.zeros_like(made.label)
        for value, known in IDS.items():
            label[made.label == value] = known
        write_png(folder / "pylon_camera_node" / f"{name}.png", made.rgb)
        write_png(folder / "pylon_camera_node_label_id" / f"{name}.png", label)
        scan = folder / "os1_cloud_node_kitti_bin" / f"{n:06d}.bin"
        scan.parent.mkdir(exist_ok=True)
        height, width = SIZE
        camera = Camera(FX + seed // 2, FY, CX, CY, width=width, height=height)
        scan.write_bytes(scan_of(sparse(seed), camera).tobytes())
        calibration = root / place / sequence
        calibration.mkdir(parents=True, exist_ok=True)
        (calibration / "camera_info.txt").write_text(f"{FX + seed // 2} {FY} {CX} {CY}\n")
        lines = ["os1_cloud_node-pylon_camera_node:", "  q:"]
        lines += [f"    {axis}: {value}" for axis, value in Q.items()]
        lines += ["  t:", *(f"    {axis}: {value}" for axis, value in T.items())]
        (calibration / "transforms.yaml").write_text("\n".join(lines) + "\n")
    return seeds


def write_lists(folder: Path, ids: list[str]) -> None:
    for split, frame_id in zip(("train", "val", "test"), ids, strict=False):
        sequence, name = frame_id.split("/")
        image = f"{sequence}/pylon_camera_node/{name}.png"
        label = f"{sequence}/pylon_camera_node_label_id/{name}.png"
        row = image if split == "test" else f"{image} {label}"
        (folder / f"{split}.lst").write_text(row + "\n")


@pytest.fixture
def rellis(tmp_path: Path) -> Path:
    root = tmp_path / "Rellis-3D"
    write_lists(root, [*write_rellis(root)])
    return root


@pytest.mark.parametrize("place", ["calibration", "."])
def test_frames_are_what_the_folders_and_the_truth_say(tmp_path: Path, place: str) -> None:
    root = tmp_path / "Rellis-3D"
    seeds = write_rellis(root, place)
    write_lists(root, [*seeds])
    reader = open_reader(root)
    assert reader.info.name == "rellis"
    assert reader.ids == tuple(sorted(seeds))
    splits = dict(zip(seeds, ("train", "val", "test", "none"), strict=True))
    names = {c.name: c.id for c in reader.info.classes}
    assert sorted(names.values()) == list(range(19))
    for frame_id, seed in seeds.items():
        frame, made = reader.read(frame_id), scene(seed)
        assert reader.group(frame_id) == frame_id.split("/")[0]
        assert reader.fixed_split(frame_id) == splits[frame_id]
        camera = frame.camera
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (FX + seed // 2, FY, CX, CY)
        where = pixel_map(camera, Distortion("brown", COEFFICIENTS[:4]))
        assert frame.depth_m is not None
        # The pinhole's own pixels, whatever the lens does: no remapping loses any.
        np.testing.assert_allclose(
            frame.depth_m, np.where(where.inside, sparse(seed), 0), rtol=1e-5
        )
        expected = np.full(SIZE, 255, np.uint8)
        for value, name in NAMES.items():
            expected[made.label == value] = names[name]
        np.testing.assert_array_equal(frame.label, nearest_through(expected, where, 255))
        assert frame.rgb is not None
        assert not np.array_equal(frame.rgb, made.rgb)


def test_published_ids_are_kept_where_they_are_asked_for(rellis: Path) -> None:
    reader = open_reader(rellis, ReaderOptions(label_set="ids"))
    assert {c.id for c in reader.info.classes} >= {1, 3, 10, 34}
    label = reader.read(reader.ids[0]).label
    assert label is not None
    assert {*np.unique(label).tolist()} - {255} == {7, 8, 10, 12}


def test_depth_alone_and_other_sizes_are_read(rellis: Path) -> None:
    whole, half = open_reader(rellis), open_reader(rellis, ReaderOptions(size="18x12"))
    first = whole.ids[0]
    alone = whole.read(first, ["depth"])
    assert (alone.rgb, alone.label) == (None, None)
    np.testing.assert_array_equal(alone.depth_m, whole.read(first).depth_m)
    small = half.read(first)
    assert small.depth_m is not None
    assert small.depth_m.shape == small.camera.shape == (12, 18)
    apart = np.abs(small.depth_m[..., None] - np.unique(sparse(0))).min(axis=-1)
    assert apart.max() < 1e-5


def test_convert_says_that_depth_is_sparse_and_keeps_the_lists(
    rellis: Path, tmp_path: Path
) -> None:
    done = CliRunner().invoke(main, ["convert", str(rellis), str(tmp_path / "r.zarr")])
    assert done.exit_code == 0, done.stderr
    assert "--fill linear" in done.stderr
    store = nimprep.open_store(tmp_path / "r.zarr")
    assert sorted(store.splits.values()) == ["none", "test", "train", "val"]
    assert "ICRA 2021" in store.about.references[0]["citation"]


def test_frames_in_several_lists_are_in_the_last_and_others_in_no_split(rellis: Path) -> None:
    ids = open_reader(rellis).ids
    for split in ("train", "val", "test"):
        sequence, name = ids[0].split("/")
        (rellis / f"{split}.lst").write_text(f"{sequence}/pylon_camera_node/{name}.jpg\n")
    reader = open_reader(rellis)
    assert [reader.fixed_split(i) for i in ids] == ["test", "none", "none", "none"]
    notes = " ".join(reader.info.notes)
    assert "1 frames are in the lists of several splits" in notes
    assert "3 of 4 frames are in none of its lists" in notes


def test_lists_may_be_elsewhere_or_nowhere(rellis: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "lists"
    elsewhere.mkdir()
    for path in sorted(rellis.glob("*.lst")):
        shutil.move(path, elsewhere / path.name)
    free = open_reader(rellis)
    assert {free.fixed_split(i) for i in free.ids} == {None}
    assert any("--lists" in note for note in free.info.notes)
    given = open_reader(rellis, ReaderOptions(lists=elsewhere))
    assert {given.fixed_split(i) for i in given.ids} == {"train", "val", "test", "none"}


def test_images_without_labels_are_left_out_and_said(rellis: Path) -> None:
    lost = open_reader(rellis).ids[3]
    (rellis / lost.replace("/", "/pylon_camera_node_label_id/")).with_suffix(".png").unlink()
    reader = open_reader(rellis)
    assert lost not in reader.ids
    assert any("1 of 4 frames are left out: they have no label" in n for n in reader.info.notes)
    assert lost in open_reader(rellis, labels=False).ids


def test_archives_may_lie_side_by_side(rellis: Path, tmp_path: Path) -> None:
    expected = open_reader(rellis)
    root = tmp_path / "apart"
    kinds = ("pylon_camera_node", "pylon_camera_node_label_id", "os1_cloud_node_kitti_bin")
    for kind in kinds:
        for sequence in ("00000", "00003"):
            target = root / f"Rellis_3D_{kind}" / "Rellis-3D" / sequence
            target.mkdir(parents=True)
            shutil.move(rellis / sequence / kind, target / kind)
    shutil.move(rellis / "calibration", root / "calibration")
    for path in sorted(rellis.glob("*.lst")):
        shutil.move(path, root / path.name)
    reader = open_reader(root)
    assert reader.ids == expected.ids
    assert reader.fixed_split(reader.ids[0]) == "train"
    assert reader.read(reader.ids[0]).depth_m is not None


@pytest.mark.parametrize(
    ("lost", "said"),
    [
        ("*/os1_cloud_node_kitti_bin", "expected depth files .*unpack LiDAR SemanticKITTI Format"),
        ("*/pylon_camera_node_label_id", "expected label files .*unpack Full Image Annotations ID"),
        ("*/pylon_camera_node", "for rellis it lacks .*pylon_camera_node.*unpack Full Images"),
        ("calibration/*/camera_info.txt", "expected camera files .*unpack Camera Intrinsic"),
        ("calibration/*/transforms.yaml", "expected to_camera files .*unpack Camera to LiDAR"),
    ],
)
def test_a_part_that_is_not_there_is_named(rellis: Path, lost: str, said: str) -> None:
    for path in sorted(rellis.glob(lost)):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(LayoutError, match=said):
        open_reader(rellis)


def test_a_folder_too_deep_is_answered_and_the_archives_own_is_taken(
    rellis: Path, tmp_path: Path
) -> None:
    for wrong in (rellis / "00000", rellis / "00000/pylon_camera_node", rellis / "calibration"):
        with pytest.raises(LayoutError, match=rf"did you mean {rellis}\?"):
            open_reader(wrong)
    assert len(open_reader(tmp_path, labels=False, depth=False).ids) == 4


def test_a_scan_that_shows_nothing_is_a_bad_frame(rellis: Path) -> None:
    scan = rellis / "00000/os1_cloud_node_kitti_bin/000004.bin"
    reader = open_reader(rellis)
    rows = np.frombuffer(scan.read_bytes(), "<f4").reshape(-1, 4)
    for points, said in (
        (rows[:2, :3], "expected whole points of 16 bytes"),
        (rows * 0 + [0, 0, 50, 0], "expected points in the image, found none"),
        (rows * 1000, "expected a median depth"),
    ):
        scan.write_bytes(points.astype("<f4").tobytes())
        with pytest.raises(DecodeError, match=said):
            reader.read(reader.ids[0])
    scan.unlink()
    lacking = open_reader(rellis)
    with pytest.raises(DecodeError, match="expected depth of frame"):
        lacking.read(lacking.ids[0])


def test_inspect_names_it_and_its_description_reads_the_same(rellis: Path, tmp_path: Path) -> None:
    found = inspect_source(rellis)
    assert (found.kind, found.reader) == ("reader", "rellis")
    (tmp_path / "d.json").write_text(json.dumps(found.description))
    described = open_reader(rellis, ReaderOptions(description=tmp_path / "d.json"))
    named = open_reader(rellis)
    assert (described.ids, described.info) == (named.ids, named.info)
    some = named.ids[1]
    np.testing.assert_array_equal(described.read(some).depth_m, named.read(some).depth_m)
    assert rellis / "calibration/00000/transforms.yaml" in named.sources(named.ids[0])


def polynomial(points: npt.NDArray[np.float64], camera: Camera) -> npt.NDArray[np.float64]:
    """Return where OpenCV's model puts points, pixels."""
    found, _ = cv2.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), camera.matrix, np.array(COEFFICIENTS)
    )
    return np.asarray(found[:, 0], np.float64)


def test_the_real_frame_has_the_counts_that_are_known(reference_data: Path) -> None:
    root = reference_data / "rellis"
    reader = open_reader(root)
    (frame_id,) = reader.ids
    frame = reader.read(frame_id)
    camera, depth = frame.camera, frame.depth_m
    assert depth is not None
    scan = np.fromfile(next(root.rglob("*.bin")), "<f4").reshape(-1, 4)[:, :3].astype(float)
    to_scanner = transform_from_file(next(root.rglob("*.yaml")), TransformSource(files=""))
    seen = (scan - to_scanner[:, 3]) @ to_scanner[:, :3]
    seen = seen[seen[:, 2] > 1e-4]
    u, v = np.rint(polynomial(seen, camera)).T
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    raw = cv2.imread(str(next(root.rglob("*_label_id/*.png"))), cv2.IMREAD_UNCHANGED)
    assert raw is not None
    sky = raw[v[inside].astype(int), u[inside].astype(int)] == 7
    # What was counted of this frame: all that the lens's polynomial puts into the image.
    assert (inside.sum(), sky.sum()) == (8748, 25)
    percentiles = np.percentile(seen[inside, 2], [5, 50, 95])
    np.testing.assert_allclose(percentiles, [2.95, 9.07, 24.64], atol=0.005)
    # 1133 of them are 62 degrees and more aside, where the camera sees 25 at its corners.
    aside = np.hypot(seen[:, 0], seen[:, 1]) / seen[:, 2]
    folded = inside & (aside > 1.27)
    assert folded.sum() == 1133
    assert aside[folded].min() > np.tan(np.radians(62)) > 1.27
    assert aside[inside & ~folded].max() < np.tan(np.radians(25))
    # The others are those of the image without distortion, but for its border.
    u, v = (
        np.rint(seen[:, 0] / seen[:, 2] * camera.fx + camera.cx),
        np.rint(seen[:, 1] / seen[:, 2] * camera.fy + camera.cy),
    )
    straight = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    assert not (straight & ~inside).any()
    assert not (straight & folded).any()
    assert straight.sum() == (depth > 0).sum() == 7429
    names = {c.name: c.id for c in reader.info.classes}
    assert frame.label is not None
    assert (frame.label[depth > 0] == names["sky"]).sum() < 30
    assert {*np.unique(frame.label).tolist()} <= {*names.values()}


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("t.yaml", "q: {w: 1, x: 0, y: 0, z: 0}\nt: {x: 1, y: 2, z: 3}\n"),
        (
            "t.yaml",
            "one:\n  rotation: {w: 1, x: 0, y: 0, z: 0}\n  translation: {x: 1, y: 2, z: 3}\n",
        ),
        ("t.json", '{"T": [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]}'),
        ("t.txt", "1 0 0 1\n0 1 0 2\n0 0 1 3\n"),
        ("calib.txt", "Tr: 1 0 0 1 0 1 0 2 0 0 1 3\n"),
    ],
)
def test_a_transform_is_read_of_any_usual_file(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    found = transform_from_file(tmp_path / name, TransformSource(files=name))
    np.testing.assert_array_equal(found, [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3]])
    back = transform_from_file(tmp_path / name, TransformSource(files=name, invert=True))
    np.testing.assert_array_equal(back, [[1, 0, 0, -1], [0, 1, 0, -2], [0, 0, 1, -3]])


@pytest.mark.parametrize(
    ("text", "key", "said"),
    [
        ("q: {w: 1, x: 0, y: 0, z: 0}\n", None, "expected a rotation and a shift"),
        ("q: {w: 2, x: 0, y: 0, z: 0}\nt: {x: 1, y: 2, z: 3}\n", None, "quaternion of length 2"),
        ("q: {w: 1, x: 0, y: 0, z: 0}\nt: {x: 100, y: 2, z: 3}\n", None, "a shift of at most 10 m"),
        ("a: {q: 1}\nb: {q: 1}\n", "c", "expected the transform 'c', found a, b"),
        ("m: [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0]\n", "m", r"found the rotation \[\[2"),
    ],
)
def test_a_file_that_says_no_transform_is_refused(
    tmp_path: Path, text: str, key: str | None, said: str
) -> None:
    (tmp_path / "t.yaml").write_text(text)
    with pytest.raises(CameraError, match=said):
        transform_from_file(tmp_path / "t.yaml", TransformSource(files="t.yaml", key=key))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"to_camera": None}, "expected 'to_camera' with depth whose values are points"),
        ({"invalid": [0]}, "expected no 'invalid' with depth whose values are 'points'"),
        ({"values": "depth"}, "expected no 'to_camera' with depth whose values are 'depth'"),
    ],
)
def test_a_description_of_points_says_all_of_them_and_nothing_of_images(
    change: dict[str, object], said: str
) -> None:
    depth = {
        "files": "{id}.bin",
        "values": "points",
        "scale_m": 1,
        "to_camera": {"files": "t.yaml"},
    }
    depth = {name: value for name, value in {**depth, **change}.items() if value is not None}
    document = {"format": "nimprep-folder", "version": "1.1", "name": "x", "rgb": "{id}.png"}
    with pytest.raises(LayoutError, match=said):
        description_from_document({**document, "depth": depth}, "d.json")
