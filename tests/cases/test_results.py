"""Cases 32 and 36: what people hand to KITTI's tools, and the folders that networks ask for."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

import nimprep
from tests.cases.cases import nimprep_run
from tests.kitti.scenes import ground_truth, write_calibration, write_png

Case = Callable[[str], Path]

FRAMES = ("um_000000", "umm_000000", "uu_000000")
NAMES = [f"{name.replace('_', '_road_')}.png" for name in FRAMES]

P2 = np.array([[721.5, 0, 609.6, 0], [0, 721.5, 172.9, 0], [0, 0, 1, 0]])


@pytest.fixture(scope="module")
def road(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the calibrations, photographs and ground truths of the case's three frames."""
    root = tmp_path_factory.mktemp("road")
    truth = np.zeros((375, 1242), bool)
    truth[250:, 400:800] = True
    for frame, name in zip(FRAMES, NAMES, strict=True):
        write_calibration(root / "calib" / f"{frame}.txt", P2=P2)
        write_png(root / "image_2" / f"{frame}.png", np.full((375, 1242, 3), 90, np.uint8))
        write_png(root / "gt_image_2" / name, ground_truth(truth))
    return root


@pytest.mark.parametrize("form", ["framename", "u16", "half", "upper"])
def test_maps_of_every_kind_are_packed_and_scored_alike(
    case: Case, road: Path, tmp_path: Path, form: str
) -> None:
    maps = case("32-") / form
    calib = ("--calib", road / "calib")
    packed = nimprep_run("kitti", "pack", maps, tmp_path / "o.zip", "--partial", *calib)
    assert (packed.exit_code, packed.stderr) == (0, "")
    with zipfile.ZipFile(tmp_path / "o.zip") as archive:
        assert archive.namelist() == NAMES
    scored = nimprep_run("kitti", "evaluate", maps, road / "gt_image_2", *calib, "--json")
    assert (scored.exit_code, scored.stderr) == (0, "")
    urban = json.loads(scored.stdout)["urban"]
    assert (urban["unit"], urban["MaxF"], urban["frames"]) == ("percent", 100, 3)


def test_masks_of_0_and_1_score_as_0_and_255_do(case: Case, road: Path, tmp_path: Path) -> None:
    maps = case("32-") / "zeroone"
    for path in maps.iterdir():
        mask = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert mask is not None
        assert mask.max() == 1
        write_png(tmp_path / "full" / path.name, mask * 255)
    ones, full = (
        nimprep_run("kitti", "evaluate", folder, road / "gt_image_2", "--view", "perspective")
        for folder in (maps, tmp_path / "full")
    )
    assert (ones.exit_code, ones.stdout) == (0, full.stdout)
    packed = nimprep_run(
        "kitti", "pack", maps, tmp_path / "o.zip", "--partial", "--calib", road / "calib"
    )
    assert packed.exit_code == 0
    assert "MaxF and AP sweep 256 thresholds" in packed.stderr
    with zipfile.ZipFile(tmp_path / "o.zip") as archive:
        image = cv2.imdecode(np.frombuffer(archive.read(NAMES[0]), np.uint8), -1)
    assert set(np.unique(image)) == {0, 255}


@pytest.mark.parametrize(
    ("form", "said"),
    [
        ("rgb", "um_road_000000.png (expected 8-bit or 16-bit grey, found 8-bit RGB)"),
        ("resized", "um_road_000000.png (expected 1242x375 or 400x800, found 1216x352)"),
        ("jpg", "3 extra: um_road_000000.jpg (expected .png or .npy)"),
        ("logits", "um_road_000000.npy: expected probabilities in [0, 1], found -4 to 3.96875"),
        ("twochannel", "found (2, 375, 1242) of float32; write one plane, that of the road"),
        ("batch", "found (1, 375, 1242) of float32; write one plane, that of the road"),
        ("u8npy", "found (375, 1242) of uint8; write them as float32, 0 to 1"),
    ],
)
def test_what_is_no_confidence_is_refused_with_its_reason(
    case: Case, road: Path, tmp_path: Path, form: str, said: str
) -> None:
    maps = case("32-") / form
    calib = ("--calib", road / "calib")
    result = nimprep_run("kitti", "pack", maps, tmp_path / "o.zip", "--partial", *calib)
    assert (result.exit_code, result.stderr.count("\n")) == (1, 1)
    assert said in result.stderr
    assert "missing" not in result.stderr
    assert not (tmp_path / "o.zip").exists()


def test_hha_and_normals_are_folders_that_decode_to_the_stores(case: Case, tmp_path: Path) -> None:
    root = case("36-")
    camera = ("--camera", root / "camera.json")
    assert nimprep_run("convert", root, tmp_path / "s.zarr", *camera).exit_code == 0
    out = tmp_path / "out"
    options = ("--format", "png", "--modalities", "hha,normal")
    assert nimprep_run("export", tmp_path / "s.zarr", out, *options).exit_code == 0
    for name in ("hha", "normal"):
        assert [p.name for p in sorted((out / name).iterdir())] == [
            f"{i:06d}.png" for i in range(4)
        ]
    said = json.loads((out / "encodings.json").read_text())["modalities"]["normal"]
    assert said["value"] == "(png - 128) / 127"
    for frame in nimprep.open_store(tmp_path / "s.zarr"):
        assert frame.normal is not None
        image = cv2.imread(str(out / "normal" / f"{frame.id}.png"), cv2.IMREAD_COLOR_RGB)
        assert image is not None
        found = (image.astype(np.float64) - 128) / 127
        some = image.any(axis=2)
        np.testing.assert_array_equal(some, frame.normal.any(axis=2))
        assert np.abs(found - frame.normal)[some].max() <= 1 / 127
        hha = cv2.imread(str(out / "hha" / f"{frame.id}.png"), cv2.IMREAD_COLOR_RGB)
        np.testing.assert_array_equal(hha, frame.hha)
