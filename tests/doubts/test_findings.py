"""What is found in frames that are read rightly: noise in normals, no floor, one value."""

from __future__ import annotations

import json
import math
import re
import shutil
import warnings
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.camera import Camera
from nimprep.cli import main
from nimprep.derive.completion import fill_depth
from nimprep.derive.normal_noise import normal_noise
from nimprep.doubts.findings import RULES, TITLES, find
from nimprep.doubts.judge import percent
from nimprep.doubts.surfaces import (
    NOISY_DEG,
    ROUGH_DEG,
    cut_signs,
    depth_counts_sign,
    joined_noise,
    level_signs,
    noise_of,
    normal_signs,
)
from nimprep.errors import DoubtWarning, FindingWarning
from nimprep.modality import MODALITIES
from nimprep.report.collect import collect
from nimprep.report.findings import find as report_findings
from nimprep.schema import schema_problems
from nimprep.store.frames import to_integers
from nimprep.store.info import info_text, store_info
from tests.doubts.real_frames import RealFrame, dense_frames, kitti_scan
from tests.doubts.streets import street
from tests.fakes import write_png

CAMERA = Camera(150.0, 150.0, 89.5, 59.5, 180, 120)


def write_frames(root: Path, depths: list[npt.NDArray[np.float32]], first: int = 0) -> Path:
    """Write frames in GMRP's layout, of these depths in metres."""
    for number, depth in enumerate(depths, first):
        name = f"{number:06d}.png"
        write_png(root / "rgb" / name, np.full((*CAMERA.shape, 3), 90 + number, np.uint8))
        write_png(root / "depth_u16" / name, np.rint(depth * 1000).astype(np.uint16))
    (root / "camera.json").write_text(json.dumps(CAMERA.to_dict()))
    return root


def noisy_street(seed: int = 0, share: float = 0.01) -> npt.NDArray[np.float32]:
    depth = street(CAMERA)
    noise = np.random.default_rng(seed).normal(0, share, depth.shape)
    return (depth * (1 + noise)).astype(np.float32)


def wall() -> npt.NDArray[np.float32]:
    """Return a wall that fills the view, a slope to one side so that its depth differs."""
    return np.tile(np.linspace(4, 6, CAMERA.width, dtype=np.float32), (CAMERA.height, 1))


def converted(source: Path, target: Path, **options: object) -> nimprep.Store:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FindingWarning)
        warnings.filterwarnings("ignore", ".*no calibration")
        return nimprep.convert(source, target, labels=False, **options)


def kinds(store: nimprep.Store) -> list[str]:
    return [finding["kind"] for finding in store.about.findings]


def test_noise_is_measured_as_it_was_made() -> None:
    noise = normal_noise(noisy_street(), CAMERA)
    assert noise.relative == pytest.approx(0.01, rel=0.15)
    # Half the difference of two errors of 1 % over the pixel's angle.
    turned = math.degrees(math.atan(150 * 0.01 / math.sqrt(2)))
    assert noise.expected_deg == pytest.approx(turned, rel=0.08)
    assert noise.roughness_deg > 15
    clean = normal_noise(street(CAMERA), CAMERA)
    assert clean.expected_deg < 0.2
    assert clean.roughness_deg < 0.2
    assert clean.relative < 1e-4


def test_noise_that_is_alike_in_neighbours_turns_normals_less() -> None:
    errors = np.random.default_rng(0).normal(0, 1, CAMERA.shape)
    smooth = sum(np.roll(errors, (i, j), (0, 1)) for i in range(6) for j in range(6)) / 6
    depth = street(CAMERA)
    rough, alike = ((depth * (1 + 0.01 * e)).astype(np.float32) for e in (errors, smooth))
    assert normal_noise(alike, CAMERA).expected_deg < 0.5 * normal_noise(rough, CAMERA).expected_deg


def test_noise_of_depth_without_neighbours_is_not_said_to_be_none() -> None:
    sparse = np.zeros(CAMERA.shape, np.float32)
    sparse[::3, ::3] = noisy_street()[::3, ::3]
    assert math.isnan(normal_noise(sparse, CAMERA).relative)
    assert math.isnan(normal_noise(sparse, CAMERA).expected_deg)
    assert noise_of([normal_signs(sparse, CAMERA, smoothed=False)]) is None


def test_without_a_road_there_is_no_roughness_and_so_no_finding() -> None:
    noisy = (wall() * np.random.default_rng(0).normal(1, 0.01, CAMERA.shape)).astype(np.float32)
    assert math.isnan(normal_noise(noisy, CAMERA).roughness_deg)
    signs = normal_signs(noisy, CAMERA, smoothed=False)
    assert signs.keys() == {"noise_relative", "noise_expected_deg"}
    assert find([("a", signs)]) == []


def real_frames(data: Path) -> list[tuple[RealFrame, bool]]:
    """Return the real frames that show a road, and whether their depth is stereo's."""
    frames = [(f, f.name == "gmrp" or f.name.startswith("stereo")) for f in dense_frames(data)]
    scan = kitti_scan(data)
    near, _ = fill_depth(scan.depth_m, "nearest")
    frames.append((RealFrame("nearest", near, scan.camera), False))
    return [pair for pair in frames if not pair[0].name.startswith("depth_")]


def test_stereo_frames_are_noisy_and_completed_ones_are_not(reference_data: Path) -> None:
    frames = real_frames(reference_data)
    assert sum(stereo for _, stereo in frames) == 7
    assert len(frames) >= 12
    for frame, stereo in frames:
        depth = np.ascontiguousarray(frame.depth_m, np.float32)
        noise = normal_noise(depth, frame.camera)
        # With room to either side: the next frame is another.
        if stereo:
            assert noise.expected_deg > 1.4 * NOISY_DEG, frame.name
            assert noise.roughness_deg > 1.5 * ROUGH_DEG, frame.name
            assert noise.relative > 0.01, frame.name
        else:
            assert noise.expected_deg < NOISY_DEG / 1.4, frame.name
        for smoothed in (False, True):
            signs = normal_signs(depth, frame.camera, smoothed=smoothed)
            found = [f.kind for f in find([(frame.name, signs)])]
            assert found == (["noisy-normals"] if stereo and not smoothed else []), frame.name


def test_convert_says_noise_in_one_line_on_real_stereo(
    reference_data: Path, tmp_path: Path
) -> None:
    out = str(tmp_path / "s.zarr")
    command = ["convert", str(reference_data / "gmrp"), out, "--modalities", "depth,normal"]
    done = CliRunner().invoke(main, [*command, "--no-labels"])
    assert done.exit_code == 0
    (line,) = (s for s in done.stderr.splitlines() if "--normals nim-edge" in s)
    assert re.search(r"turned by 2\d degrees in the median.* \(1 frame, first '000001'\)$", line)
    store = nimprep.open_store(out)
    assert schema_problems(store.attributes, "store") == []
    noise = store.about.normal_noise
    assert noise is not None
    assert noise["frames"] == 1
    assert 0.01 < noise["relative"] < 0.02
    assert 15 < noise["expected_deg"] < 25
    assert 18 < noise["roughness_deg"] < 25
    info = store_info(store)
    assert (info["findings"], info["normal_noise"]) == (store.about.findings, noise)
    assert schema_problems(info, "info") == []
    text = info_text(info)
    assert re.search(r"^finding  normals are noise: .*--normals nim-edge", text, re.M)
    assert re.search(r"^noise    1\.\d+ % of the distance, turns normals by nim by \d", text, re.M)
    (found,) = (f for f in report_findings(store, collect(store)) if "nim-edge" in f.text)
    assert (found.kind, found.frames) == ("found-noisy-normals", (0,))


@pytest.mark.parametrize(
    "options", [{"normals": "nim-edge"}, {"modalities": ("depth",)}], ids=["nim-edge", "none"]
)
def test_noise_is_not_said_where_it_is_smoothed_or_there_are_no_normals(
    reference_data: Path, tmp_path: Path, options: dict[str, object]
) -> None:
    given = {"modalities": ("depth", "normal"), **options}
    store = converted(reference_data / "gmrp", tmp_path / "s.zarr", **given)
    assert kinds(store) == []
    assert (store.about.normal_noise is None) == ("normal" not in store.modalities)


def test_kittis_stereo_is_noisy_beside_its_completed_depth(
    reference_data: Path, tmp_path: Path
) -> None:
    store = converted(reference_data / "kitti_road", tmp_path / "s.zarr")
    (finding,) = store.about.findings
    assert finding["kind"] == "noisy-normals"
    assert finding["frames"] == ["training/um_000000", "training/umm_000000"]


def test_a_filled_scan_is_said_nothing_of(reference_data: Path, tmp_path: Path) -> None:
    folder = tmp_path / "road/training"
    frame = reference_data / "kitti_lidar"
    for name in ("image_2", "velodyne", "calib"):
        (folder / name).mkdir(parents=True)
    shutil.copy(frame / "image_2/000000.png", folder / "image_2/um_000000.png")
    shutil.copy(frame / "velodyne/000000.bin", folder / "velodyne/um_000000.bin")
    other = (reference_data / "kitti_road/training/calib/um_000000.txt").read_text()
    (road,) = (s for s in other.splitlines() if s.startswith("Tr_cam_to_road"))
    numbers = (frame / "calib/000000.txt").read_text().rstrip()
    (folder / "calib/um_000000.txt").write_text(f"{numbers}\n{road}\n")
    store = converted(tmp_path / "road", tmp_path / "s.zarr")
    assert kinds(store) == []
    assert store.about.normal_noise is not None


@pytest.mark.filterwarnings("ignore:.*no calibration")
def test_hha_from_the_lowest_point_is_saturated_on_a_real_frame(
    reference_data: Path, tmp_path: Path
) -> None:
    options = {"modalities": ("depth", "hha"), "labels": False}
    target = tmp_path / "lowest.zarr"
    with pytest.warns(FindingWarning, match=r"height above ground is saturated, more than 99\.9%"):
        store = nimprep.convert(reference_data / "gmrp", target, hha_ground="lowest", **options)
    assert kinds(store) == ["one-value-hha-1"]
    (found,) = (f for f in report_findings(store, collect(store)) if "saturated" in f.text)
    assert found.title == "HHA saturated: height above ground"
    floor = nimprep.convert(reference_data / "gmrp", tmp_path / "floor.zarr", **options)
    assert kinds(floor) == []


def test_one_value_is_measured_where_there_is_some_and_a_level_road_is_none() -> None:
    image = np.zeros((160, 160, 3), np.uint8)
    assert level_signs({"hha": image}) == {}
    image[40:] = (30, 20, 38)
    image[40:60] = (31, 60, 128)
    signs = level_signs({"hha": image, "rgb": image})
    assert signs["hha_at_one_0"] == pytest.approx(100 / 120, abs=0.01)
    assert signs["hha_at_one_1"] == signs["hha_at_one_2"] == 0
    image[40:, :, 1] = 255
    assert level_signs({"hha": image})["hha_at_one_1"] == 1
    assert level_signs({"hha": image[:100, :100]}) == {}
    counts = np.zeros(65536, np.int64)
    counts[0], counts[2000], counts[3000:4000] = 10**6, 20_000, 10
    assert depth_counts_sign(counts) == {"depth_at_one": pytest.approx(2 / 3)}


def test_depth_that_is_cut_at_a_value_is_found(tmp_path: Path) -> None:
    depth = street(CAMERA, wall_m=30)
    source = write_frames(tmp_path / "a", [np.minimum(depth, np.float32(3))])
    store = converted(source, tmp_path / "a.zarr", modalities=("rgb", "depth"))
    assert kinds(store) == ["one-value-depth"]
    assert re.match(r"depth is saturated, \d\d\.?\d?% of it", store.about.findings[0]["text"])


def test_frames_without_a_floor_are_counted_and_said(tmp_path: Path) -> None:
    source = write_frames(tmp_path / "a", [street(CAMERA), wall(), wall()])
    options = {"modalities": ("depth", "hha"), "labels": False}
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        store = nimprep.convert(source, tmp_path / "a.zarr", **options)
    finding, wall_angle = store.about.findings
    (line,) = (str(w.message) for w in said if "no floor is in view" in str(w.message))
    assert line.endswith("(2 frames, first '000001')")
    assert (finding["kind"], finding["count"]) == ("no-floor", 2)
    assert wall_angle["kind"] == "one-value-hha-2"
    assert finding["frames"] == ["000001", "000002"]
    lowest = converted(source, tmp_path / "b.zarr", hha_ground="lowest", modalities=("hha",))
    assert "no-floor" not in kinds(lowest)


def test_findings_and_noise_are_carried_by_append_and_merge(tmp_path: Path) -> None:
    noisy = write_frames(tmp_path / "a", [noisy_street(0), noisy_street(1)])
    clean = write_frames(tmp_path / "b", [street(CAMERA)], first=2)
    again = write_frames(tmp_path / "c", [noisy_street(3)], first=3)
    store = converted(noisy, tmp_path / "a.zarr")
    quiet = converted(clean, tmp_path / "b.zarr")
    assert (kinds(store), kinds(quiet)) == (["noisy-normals"], [])
    parts = [store.about.normal_noise, quiet.about.normal_noise]
    with warnings.catch_warnings():
        warnings.simplefilter("error", FindingWarning)
        grown = nimprep.append_frames(clean, tmp_path / "a.zarr").store
    assert grown.about.findings == store.about.findings
    assert grown.about.normal_noise == joined_noise(parts)
    with pytest.warns(FindingWarning, match=r"\(3 frames, first '000000'\)$"):
        grown = nimprep.append_frames(again, tmp_path / "a.zarr").store
    assert schema_problems(grown.attributes, "store") == []
    merged = nimprep.merge_stores(
        [tmp_path / "b.zarr", tmp_path / "a.zarr"], tmp_path / "m.zarr", prefixes=["x/", "y/"]
    )
    (finding,) = merged.about.findings
    assert finding["frames"] == ["y/000000", "y/000001", "y/000003"]
    assert merged.about.normal_noise is not None
    assert merged.about.normal_noise["frames"] == 5


def test_noise_of_parts_is_their_mean_by_frames() -> None:
    one = {"frames": 1, "relative": 0.01, "expected_deg": 20.0, "roughness_deg": 10.0}
    other = {"frames": 3, "relative": 0.02, "expected_deg": 40.0}
    assert joined_noise([None, one]) == one
    assert joined_noise([None, None]) is None
    joined = joined_noise([one, other])
    assert joined == {"frames": 4, "relative": 0.0175, "expected_deg": 35, "roughness_deg": 10}
    signs = [{"noise_relative": r, "noise_expected_deg": 5.0} for r in (0.1, 0.2, 0.9)]
    assert noise_of([*signs, {}]) == {"frames": 3, "relative": 0.2, "expected_deg": 5}
    assert noise_of([{}]) is None


def test_every_finding_has_a_title() -> None:
    assert {rule.kind for rule in RULES} == TITLES.keys()


def test_findings_are_no_doubts(tmp_path: Path) -> None:
    source = write_frames(tmp_path / "a", [noisy_street()])
    with warnings.catch_warnings():
        warnings.simplefilter("error", DoubtWarning)
        store = converted(source, tmp_path / "a.zarr")
    assert (store.about.doubts, kinds(store)) == ([], ["noisy-normals"])


def test_a_share_is_said_to_be_all_only_where_it_is() -> None:
    assert [percent(x) for x in (0.0, 0.005, 0.9, 0.99, 0.9998, 1.0)] == [
        "none", "less than 1%", "90%", "99%", "more than 99.9%", "all"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "kept", "cut"),
    [
        ("disparity", [0, 0.001, 1, 255.997], [255.999, 300]),
        ("elevation", [np.nan, -32.767, 0, 32.7674], [-32.7676, 32.7676, 900]),
        ("transformed_disparity", [np.nan, -255.99, 0, 255.99], [-256, 256]),
    ],
)
def test_numbers_beyond_what_is_stored_are_counted(
    name: str, kept: list[float], cut: list[float]
) -> None:
    def signs(values: list[float]) -> dict[str, float]:
        image = np.array([values], np.float32)
        return cut_signs({name: image}, {name: to_integers(MODALITIES[name], image)})

    assert signs(kept) == {}
    # The first of those that are kept is none.
    assert signs(kept + cut) == {f"{name}_cut": len(cut) / (len(kept) - 1 + len(cut))}


def test_elevation_of_real_stereo_that_is_cut_is_said(reference_data: Path, tmp_path: Path) -> None:
    folder = reference_data / "kitti_road"
    options = {"modalities": ("depth", "elevation"), "labels": False}
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        store = nimprep.convert(folder, tmp_path / "cm.zarr", depth_unit=0.01, **options)
    (line,) = (str(w.message) for w in said if w.category is FindingWarning)
    assert "elevation is cut: less than 1% of it lies beyond ±32.767 m" in line
    (finding,) = store.about.findings
    assert finding["kind"] == "cut-elevation"
    assert finding["count"] == 2
    assert schema_problems(store.attributes, "store") == []
    assert "elevation is cut" in info_text(store_info(tmp_path / "cm.zarr"))
