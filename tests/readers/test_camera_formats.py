"""One camera in every format that people have it in."""

from __future__ import annotations

import json
import math
import re
import textwrap
from pathlib import Path
from typing import Any

import pytest

from nimprep.errors import CameraError
from nimprep.readers.camera_formats import CameraTable, numbers_from_file
from nimprep.readers.cameras import GivenCamera, camera_from_file
from nimprep.readers.description import CameraSource
from nimprep.readers.description_file import description_from_document

FX, FY, CX, CY = 525.5, 526.25, 319.75, 239.125
K = [FX, 0, CX, 0, FY, CY, 0, 0, 1]
P = [FX, 0, CX, 0, 0, FY, CY, 0, 0, 0, 1, 0]
NUMBERS = {"fx": FX, "fy": FY, "cx": CX, "cy": CY}
LENS = [-0.15, 0.3, 0.001, 0.002, 0.05]
ORB_LENS = "\n".join(
    f"Camera.{n}: {c}" for n, c in zip(("k1", "k2", "p1", "p2", "k3"), LENS, strict=True)
)


def read(tmp_path: Path, name: str, content: Any, **source: Any) -> GivenCamera:
    path = tmp_path / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return camera_from_file(path, CameraSource(**source))


def refused(tmp_path: Path, name: str, content: Any, **source: Any) -> str:
    with pytest.raises(CameraError) as caught:
        read(tmp_path, name, content, **source)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / name))
    assert "\n" not in message
    assert len(message) < 1000
    return message.removeprefix(f"{tmp_path}/")


OPENCV = f"""\
%YAML:1.0
---
calibration_time: "Mon 1 Jan 2024"
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ {FX}, 0., {CX}, 0., {FY},
       {CY}, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -1.5e-01, 3e-1, 0.001, 0.002, 0.05 ]
"""

ROS = f"""\
image_width: 640
image_height: 480
camera_name: color
camera_matrix:
  rows: 3
  cols: 3
  data: {K}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: {LENS}}}
rectification_matrix: {{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
projection_matrix: {{rows: 3, cols: 4, data: [500, 0, 320, 0, 0, 501, 240, 0, 0, 0, 1, 0]}}
"""

ECHO = f"""\
header:
  stamp: {{secs: 1, nsecs: 2}}
  frame_id: "camera"
height: 480
width: 640
distortion_model: "plumb_bob"
D: {LENS}
K: {K}
R: [1, 0, 0, 0, 1, 0, 0, 0, 1]
P: {P}
binning_x: 0
binning_y: 0
roi: {{x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}}
---
"""

KALIBR = f"""\
cam0:
  camera_model: pinhole
  distortion_coeffs: {LENS[:4]}
  distortion_model: radtan
  intrinsics: [{FX}, {FY}, {CX}, {CY}]
  resolution: [640, 480]
"""

INFO = {"width": 640, "height": 480, "distortion_model": "plumb_bob"}
REALSENSE = {"width": 640, "height": 480, "ppx": CX, "ppy": CY, "fx": FX, "fy": FY}
OPEN3D = [FX, 0, 0, 0, FY, 0, CX, CY, 1]
SIZED = {"width": 640, "height": 480}
OWN_LENS = dict(zip(("k1", "k2", "p1", "p2", "k3"), LENS, strict=True))

# name, content, whether it says the size, the distortion
READ: dict[str, tuple[str, Any, bool, list[float]]] = {
    "own": ("c.json", NUMBERS, False, []),
    "own with a lens": ("c.json", {**NUMBERS, "distortion": LENS}, False, LENS),
    "own with a lens by name": ("c.json", {**NUMBERS, **OWN_LENS}, False, LENS),
    "own with a lens twice": ("c.json", {**NUMBERS, **OWN_LENS, "distortion": LENS}, False, LENS),
    "Cityscapes": (
        "c.json",
        {"intrinsic": {"fx": FX, "fy": FY, "u0": CX, "v0": CY}, "extrinsic": {"x": 1.7}},
        False,
        [],
    ),
    "Open3D": ("c.json", {**SIZED, "intrinsic_matrix": OPEN3D}, True, []),
    "Open3D trajectory": (
        "c.json",
        {"parameters": [{"intrinsic": {**SIZED, "intrinsic_matrix": OPEN3D}}] * 3},
        True,
        [],
    ),
    "matrix by rows": ("c.json", {"K": [K[:3], K[3:6], K[6:]]}, False, []),
    "bare list": ("c.json", [K[:3], K[3:6], K[6:]], False, []),
    "RealSense": ("c.json", {**REALSENSE, "model": "Brown Conrady", "coeffs": LENS}, True, LENS),
    "RealSense without": (
        "c.json",
        {**REALSENSE, "model": "Inverse Brown Conrady", "coeffs": [0] * 5},
        True,
        [],
    ),
    "camera_info": ("c.json", {**INFO, "K": K, "D": LENS, "P": P}, True, LENS),
    "camera_info of ROS 2": ("c.json", {**INFO, "k": K, "d": LENS, "p": P}, True, LENS),
    "nerfstudio": (
        "transforms.json",
        {"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, "w": 640, "h": 480, "camera_model": "OPENCV"}
        | OWN_LENS
        | {"frames": []},
        True,
        LENS,
    ),
    "OpenCV": ("c.yml", OPENCV, True, LENS),
    "OpenCV in text": ("c.txt", OPENCV, True, LENS),
    "ROS": ("c.yaml", ROS, True, LENS),
    "rostopic echo": ("c.txt", ECHO, True, LENS),
    "Kalibr": ("camchain.yaml", KALIBR, True, LENS[:4]),
    "ORB-SLAM": (
        "o.yaml",
        f"%YAML:1.0\nCamera.fx: {FX}\nCamera.fy: {FY}\nCamera.cx: {CX}\nCamera.cy: {CY}\n"
        f"{ORB_LENS}\nCamera.fps: 30.0\n# comment\n",
        False,
        LENS,
    ),
    "COLMAP": (
        "cameras.txt",
        f"# Camera list\n#   ID, MODEL\n1 PINHOLE 640 480 {FX} {FY} {CX + 0.5} {CY + 0.5}\n",
        True,
        [],
    ),
    "COLMAP with a lens": (
        "cameras.txt",
        f"1 OPENCV 640 480 {FX} {FY} {CX + 0.5} {CY + 0.5} -0.15 0.3 0.001 0.002\n",
        True,
        LENS[:4],
    ),
    "ORFD": ("c.txt", f"cam_K: {' '.join(map(str, K))} \ncam_RT: 1 0 0\n", False, []),
    "four numbers": ("c.txt", f"{FX} {FY} {CX} {CY}\n", False, []),
    "numbers and size": ("c.txt", f"{FX} {FY} {CX} {CY} 640 480", True, []),
    "size and numbers": ("c.txt", f"640 480 {FX} {FY} {CX} {CY}", True, []),
    "two rows of K": ("c.txt", f"{FX} 0 {CX}\n0 {FY} {CY}\n", False, []),
    "numbers and k1, k2": ("c.txt", f"{FX} {FY} {CX} {CY} -0.15 0.3", False, [-0.15, 0.3, 0, 0]),
    "nine": ("c.csv", "\n".join(",".join(map(str, K[i : i + 3])) for i in (0, 3, 6)), False, []),
    "nine printed": ("c.txt", f"[[{FX}, 0., {CX}],\n [0., {FY}, {CY}],\n [0., 0., 1.]]", False, []),
    "twelve": ("c.txt", " ".join(map(str, P)), False, []),
    "sixteen": ("c.txt", f"{FX} 0 {CX} 0\n0 {FY} {CY} 0\n0 0 1 0\n0 0 0 1\n", False, []),
    "lines of names": ("c.txt", f"fx: {FX}\nfy: {FY}\ncx: {CX}\ncy: {CY}\n", False, []),
    "settings": ("c.ini", f"fx = {FX}\nfy = {FY}\ncx = {CX}\ncy = {CY}\n", False, []),
    "one row of a table": ("c.csv", f"fx,fy,cx,cy\n{FX},{FY},{CX},{CY}\n", False, []),
}


@pytest.mark.parametrize("case", READ)
def test_a_camera_is_the_same_in_every_format(tmp_path: Path, case: str) -> None:
    name, content, sized, lens = READ[case]
    camera = read(tmp_path, name, content)
    assert camera.intrinsics == (FX, FY, CX, CY)
    assert camera.size == ((480, 640) if sized else None)
    assert math.isnan(camera.baseline_m)
    found = camera.distortion.coefficients if camera.distortion else ()
    assert list(found) == lens
    if camera.distortion:
        assert camera.distortion.model == "brown"


def test_colmap_counts_pixels_by_their_corners(tmp_path: Path) -> None:
    camera = read(tmp_path, "cameras.txt", "7 SIMPLE_RADIAL 640 480 500 320 240 0.1\n")
    assert camera.intrinsics == (500, 500, 319.5, 239.5)
    assert camera.distortion
    assert camera.distortion.coefficients == (0.1, 0, 0, 0)


@pytest.mark.parametrize(
    ("model", "params", "kind", "lens"),
    [
        ("SIMPLE_PINHOLE", "500 320 240", None, ()),
        ("RADIAL", "500 320 240 0.1 0.2", "brown", (0.1, 0.2, 0, 0)),
        ("OPENCV_FISHEYE", "500 500 320 240 1 2 3 4", "fisheye", (1, 2, 3, 4)),
        (
            "FULL_OPENCV",
            "500 500 320 240 1 2 3 4 5 6 7 8",
            "brown",
            (1, 2, 3, 4, 5, 6, 7, 8),
        ),
    ],
)
def test_colmaps_models_have_their_parameters_in_order(
    tmp_path: Path, model: str, params: str, kind: str | None, lens: tuple[float, ...]
) -> None:
    camera = read(tmp_path, "cameras.txt", f"1 {model} 640 480 {params}\n")
    assert camera.intrinsics == (500, 500, 319.5, 239.5)
    found = camera.distortion
    assert (found.model if found else None, found.coefficients if found else ()) == (kind, lens)


def test_of_several_cameras_one_is_named_by_key(tmp_path: Path) -> None:
    text = "1 PINHOLE 640 480 500 500 320 240\n2 PINHOLE 640 480 600 600 320 240\n"
    assert "camera.key" in refused(tmp_path, "cameras.txt", text)
    assert read(tmp_path, "cameras.txt", text, key="2").intrinsics == (600, 600, 319.5, 239.5)
    both = {"color": {**REALSENSE, "fx": 600}, "depth": REALSENSE}
    assert "'color', 'depth'" in refused(tmp_path, "c.json", both)
    assert read(tmp_path, "c.json", both, key="color").intrinsics == (600, FY, CX, CY)
    assert "found none" in refused(tmp_path, "c.json", both, key="infra")


def test_numbers_stand_where_keys_say(tmp_path: Path) -> None:
    document = {"cam": {"f": [500, 501], "c": {"x": 320, "y": 240}}, "size": [640, 480], "b": 0.12}
    keys = {"fx": "cam.f.0", "fy": "cam.f.1", "cx": "cam.c.x", "cy": "cam.c.y"}
    more = {"width": "size.0", "height": "size.1", "baseline_m": "b"}
    camera = read(tmp_path, "c.json", document, keys={**keys, **more})
    assert camera.intrinsics == (500, 501, 320, 240)
    assert (camera.size, camera.baseline_m) == ((480, 640), 0.12)
    assert "'cam.f.2'" in refused(tmp_path, "c.json", document, keys={**keys, "fx": "cam.f.2"})
    some = {name: keys[name] for name in ("fx", "fy", "cx")}
    assert "expected cy among 'keys', found none; add it" in refused(
        tmp_path, "c.json", document, keys=some
    )
    text = "fx_color = 1170.2\nfy_color = 1170.3\nmx_color = 647.7\nmy_color = 483.7\nn = 5\n"
    names = {"fx": "fx_color", "fy": "fy_color", "cx": "mx_color", "cy": "my_color"}
    assert read(tmp_path, "s.txt", text, keys=names).intrinsics == (1170.2, 1170.3, 647.7, 483.7)


KITTI = """\
P0: 700 0 600 0 0 700 180 0 0 0 1 0
P1: 700 0 600 -378 0 700 180 0 0 0 1 0
P2: 700 0 600 42 0 700 180 0.2 0 0 1 0.003
P3: 700 0 600 -329 0 700 180 2 0 0 1 0.003
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0
"""


def test_kittis_lines_give_camera_2_and_its_baseline(tmp_path: Path) -> None:
    text = KITTI.replace(" 0.003", " 0")
    camera = read(tmp_path, "000000.txt", text)
    assert camera.intrinsics == (700, 700, 600, 180)
    assert camera.baseline_m == pytest.approx(0.53)
    assert read(tmp_path, "a.txt", text, key="P0").baseline_m == pytest.approx(0.54)
    assert math.isnan(read(tmp_path, "a.txt", text, key="P3").baseline_m)
    assert "P4" in refused(tmp_path, "a.txt", text, key="P4")


def test_a_projection_with_a_shift_along_z_is_read(tmp_path: Path) -> None:
    assert read(tmp_path, "000000.txt", KITTI).intrinsics == (700, 700, 600, 180)


def test_kittis_raw_calibration_asks_for_a_key(tmp_path: Path) -> None:
    text = """\
        calib_time: 09-Jan-2012 13:57:47
        corner_dist: 9.950000e-02
        S_02: 1392 512
        K_02: 960 0 690 0 957 230 0 0 1
        D_02: -0.37 0.2 0.001 0.0004 -0.07
        R_02: 0.99 0 0 0 0.99 0 0 0 1
        S_rect_02: 1242 375
        P_rect_02: 721 0 609 44.85 0 721 172 0 0 0 1 0
        P_rect_03: 721 0 609 -339.5 0 721 172 0 0 0 1 0
        """
    text = textwrap.dedent(text).replace("R_02: 0.99 0 0 0 0.99 0 0 0 1\n", "")
    assert "K_02, P_rect_02" in refused(tmp_path, "c.txt", text)
    rectified = read(tmp_path, "c.txt", text, key="P_rect_02")
    assert rectified.intrinsics == (721, 721, 609, 172)
    assert (rectified.size, rectified.distortion) == ((375, 1242), None)
    assert rectified.baseline_m == pytest.approx((44.85 + 339.5) / 721)
    raw = read(tmp_path, "c.txt", text, key="K_02")
    assert raw.size == (512, 1392)
    assert raw.distortion
    assert raw.distortion.coefficients == (-0.37, 0.2, 0.001, 0.0004, -0.07)


def test_a_cityscapes_camera_has_its_baseline(tmp_path: Path) -> None:
    document = {
        "extrinsic": {"baseline": 0.209313, "pitch": 0.038},
        "intrinsic": {"fx": 2262.52, "fy": 2265.3, "u0": 1096.98, "v0": 513.137},
    }
    camera = read(tmp_path, "a_camera.json", document)
    assert camera.intrinsics == (2262.52, 2265.3, 1096.98, 513.137)
    assert camera.baseline_m == 0.209313


def test_orb_slams_baseline_is_times_fx(tmp_path: Path) -> None:
    text = "Camera.fx: 500\nCamera.fy: 500\nCamera.cx: 320\nCamera.cy: 240\nCamera.bf: 60\n"
    assert read(tmp_path, "o.yaml", text).baseline_m == pytest.approx(0.12)


def test_rectified_images_have_the_camera_that_p_says(tmp_path: Path) -> None:
    camera = read(tmp_path, "c.yaml", ROS, distortion="rectified")
    assert camera.intrinsics == (500, 501, 320, 240)
    assert camera.distortion is None
    right = {**INFO, "K": K, "D": [], "P": [500, 0, 320, -60, 0, 500, 240, 0, 0, 0, 1, 0]}
    assert read(tmp_path, "c.json", right, distortion="rectified").baseline_m == pytest.approx(
        60 / FX
    )


def test_a_table_has_a_row_per_frame_and_camera(tmp_path: Path) -> None:
    path = tmp_path / "intrinsic.txt"
    rows = [f"{f} {c} {700 + f} 725 {600 + c} 187" for f in range(3) for c in range(2)]
    path.write_text("frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]\n" + "\n".join(rows) + "\n")
    for columns in ((), ("{frame}", "cameraID", "fx", "fy", "cx", "cy")):
        table = numbers_from_file(path, CameraSource(columns=columns))
        assert isinstance(table, CameraTable)
        found = table.of({"frame": "00002", "cameraID": "1", "scene": "Scene01"})
        assert found.intrinsics == (702, 725, 601, 187)
        with pytest.raises(CameraError, match="several by cameraID"):
            table.of({"frame": "00002"})
        with pytest.raises(CameraError, match="expected a row for frame 3, cameraID 0, found none"):
            table.of({"frame": "00003", "cameraID": "0"})


def test_rows_that_agree_need_no_telling_apart(tmp_path: Path) -> None:
    text = (
        "frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]\n0 0 725 725 620.5 187\n1 0 725 725 620.5 187\n"
    )
    assert read(tmp_path, "intrinsic.txt", text).intrinsics == (725, 725, 620.5, 187)


REFUSED: dict[str, tuple[str, Any, str]] = {
    "nothing": ("c.txt", "", "expected a camera file"),
    "prose": ("c.txt", "the camera is on the roof", "expected a camera file"),
    "five numbers": ("c.txt", "1400 1400 350 200 1", "found 5"),
    "six of no kind": ("c.txt", "500 500 320 240 20.5 30", "two are k1 and k2"),
    "TUM's nine": (
        "c.txt",
        "517.3 516.5 318.6 255.3 0.2624 -0.9531 -0.0054 0.0026 1.1633",
        "fx, 0",
    ),
    "a pose": ("c.txt", "0 -1 0 2\n1 0 0 3\n0 0 1 4\n0 0 0 1", "expected [[fx, 0, cx]"),
    "skew": ("c.txt", "500 2 320 0 500 240 0 0 1", "expected [[fx, 0, cx]"),
    "two cameras of one": ("c.json", {"fx": 1, "fy": 1, "cx": 1, "cy": 1, "K": K}, "beside K"),
    "uncalibrated": ("c.json", {**INFO, "K": [0] * 9, "D": []}, "expected [[fx"),
    "one half": ("c.json", {"fx": FX, "fy": FY, "ppx": CX}, "'cx' is a required property"),
    "unknown lens": (
        "c.json",
        {**REALSENSE, "model": "Inverse Brown Conrady", "coeffs": [0.1, -0.3, 0, 0, 0.2]},
        "Inverse Brown Conrady",
    ),
    "lens of another name": ("c.json", {**NUMBERS, "radial_distortion": [0.1, 0]}, "radial_dist"),
    "two lenses": ("c.json", {**NUMBERS, "k1": 0.1, "distortion": [0.2, 0, 0, 0]}, "beside"),
    "lens in words": ("c.json", {**NUMBERS, "dist": "see paper"}, "'dist'"),
    "too many": ("c.json", {**INFO, "K": K, "D": [0.1] * 7}, "7 numbers"),
    "omnidirectional": (
        "c.yaml",
        "cam0:\n  camera_model: omni\n  intrinsics: [1, 2, 3, 4]\n",
        "the model 'omni'",
    ),
    "COLMAP's unknown": ("cameras.txt", "1 FOV 640 480 500 500 320 240 0.9\n", "'FOV'"),
    "COLMAP's short": ("cameras.txt", "1 PINHOLE 640 480 500 320\n", "fx fy cx cy"),
    "a part": ("c.json", {**INFO, "K": K, "D": [], "roi": {"x_offset": 8}}, "roi.x_offset"),
    "binned": ("c.json", {**INFO, "K": K, "D": [], "binning_x": 2}, "binning_x"),
    "a short row": ("c.csv", "fx,fy,cx,cy\n1,2,3\n", "c.csv:2: expected 4 columns"),
    "a row twice": ("c.csv", "frame,fx,fy,cx,cy\n1,5,5,3,3\n01,6,6,3,3\n", "c.csv:3: expected one"),
    "no YAML": ("c.yaml", "a: [1, 2\nb: }", "expected a camera in YAML"),
    "aliases": ("c.yaml", "a: &a [1]\nb: *a\n", "no aliases"),
    "twice": ("c.yaml", "fx: 1\nfx: 2\n", "each key once"),
    "a list as key": ("c.yaml", "? [1, 2]\n: 3\n", "texts as keys"),
    "deep": ("c.yaml", "[" * 200 + "]" * 200, "at most 32 levels"),
    "large": ("c.yaml", "a: 1\n" * 60_000, "bytes"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_one_camera_is_refused_in_a_line(tmp_path: Path, case: str) -> None:
    name, content, words = REFUSED[case]
    message = refused(tmp_path, name, content)
    assert words in message
    assert "; " in message or "required property" in message


def test_distortion_is_refused_or_said_to_be_gone_on_request(tmp_path: Path) -> None:
    given = {**NUMBERS, "k1": -0.35}
    assert "found brown distortion (-0.35" in refused(
        tmp_path, "c.json", given, distortion="refuse"
    )
    assert read(tmp_path, "c.json", given, distortion="rectified").distortion is None
    unknown = {**REALSENSE, "model": "Inverse Brown Conrady", "coeffs": [0.1, 0, 0, 0, 0]}
    assert read(tmp_path, "c.json", unknown, distortion="rectified").intrinsics == (FX, FY, CX, CY)


def test_numbers_that_hold_for_another_size_are_scaled(tmp_path: Path) -> None:
    camera = read(tmp_path, "c.json", NUMBERS, for_size=(640, 480)).camera(240, 320, "a")
    assert (camera.fx, camera.fy) == (FX / 2, FY / 2)
    assert (camera.cx, camera.cy) == ((CX + 0.5) / 2 - 0.5, (CY + 0.5) / 2 - 0.5)
    with pytest.raises(CameraError, match="found one of 640x480; check the width"):
        read(tmp_path, "c.json", NUMBERS, for_size=(640, 480)).camera(320, 240, "a")
    with pytest.raises(CameraError, match="give --size"):
        read(tmp_path, "c.json", {**NUMBERS, **SIZED}).camera(240, 320, "a")
    sized = {**NUMBERS, **SIZED}
    assert "leave for_size out" in refused(tmp_path, "c.json", sized, for_size=(320, 240))


PAGE = Path(__file__).parent.parent.parent / "docs" / "cameras.md"


def test_the_pages_examples_are_descriptions() -> None:
    examples = re.findall(r"```json\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(examples) > 5
    for example in examples:
        base = {"format": "nimprep-folder", "version": "1.1", "name": "a", "rgb": "rgb/{id}.png"}
        made = description_from_document({**base, **json.loads(example)}, "the page")
        assert made.camera or (made.depth and (made.depth.camera or made.depth.to_camera))
