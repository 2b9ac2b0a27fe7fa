"""Camera files: anything at all in place of YAML, COLMAP's, KITTI's, numbers and tables."""

from __future__ import annotations

import os
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import strategies as st

from nimprep.errors import CameraError
from nimprep.readers.camera_formats import CameraTable, numbers_from_file
from nimprep.readers.cameras import camera_from_file
from nimprep.readers.description import CameraSource
from nimprep.readers.undistortion import pixel_map, rays
from tests.hostile.damage import damaged
from tests.hostile.fuzzing import fuzz, limited_time, survives
from tests.readers.test_camera_formats import ECHO, KALIBR, KITTI, OPENCV, ROS

WHOLE = [
    *(ROS, OPENCV, ECHO, KALIBR, KITTI),
    "525 0 320\n0 525 240\n0 0 1\n",
    "525.5 525.5 319.5 239.5 640 480\n",
    "1 OPENCV 640 480 525 525 320 240 -0.1 0.1 0 0\n2 PINHOLE 640 480 1 2 3 4\n",
    "frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]\n0 0 725 725 620.5 187\n1 0 725 725 620.5 187\n",
    "fx = 525\nfy = 525\ncx = 320\ncy = 240\nk1 = 0.1\n",
]
PIECES = st.lists(
    st.one_of(
        st.sampled_from(
            ["K: ", "P2: ", "fx: ", "D: ", "- ", "{", "[", "&a ", "*a", "!!map ", "? "]
        ),
        st.sampled_from(
            ["1e999 ", "nan ", "1_0 ", "٣ ", "0x1 ", "\n", "\r", "\x85", "---\n", "%Y "]
        ),
        st.text(max_size=20),
    ),
    max_size=60,
).map("".join)


@fuzz(
    300,
    data=st.one_of(
        st.sampled_from(WHOLE).flatmap(lambda text: damaged(text.encode())),
        PIECES.map(lambda text: text.encode("utf-8", "surrogatepass")),
    ),
    name=st.sampled_from(["c.txt", "c.yaml", "c.csv"]),
    source=st.sampled_from(
        [
            CameraSource(),
            CameraSource(key="P2", pixel_origin=1, for_size=(32, 24)),
            CameraSource(keys={"fx": "a.b", "fy": "K.0", "cx": "fx", "cy": "D"}),
            CameraSource(columns=("frame", "", "fx", "fy", "cx", "cy"), distortion="rectified"),
        ]
    ),
)
def test_any_camera_file_is_read_or_refused(
    tmp_path: Path, data: bytes, name: str, source: CameraSource
) -> None:
    path = tmp_path / name
    path.write_bytes(data)

    def read() -> None:
        given = camera_from_file(path, source)
        camera = given.camera(*(given.size or (24, 32)), "a")
        if given.distortion is not None and camera.width * camera.height < 10_000:
            pixel_map(camera, given.distortion)
            rays(camera, given.distortion)

    survives("camera files", read)


@fuzz(100, data=damaged(WHOLE[8].encode()), frame=st.text(max_size=5))
def test_any_table_is_read_or_refused(tmp_path: Path, data: bytes, frame: str) -> None:
    path = tmp_path / "t.txt"
    path.write_bytes(data)

    def read() -> None:
        table = numbers_from_file(path, CameraSource())
        if isinstance(table, CameraTable):
            table.of({"frame": frame})

    survives("camera tables", read)


BOMB = "a: &a [x, x]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [*{chr(97 + i)}, *{chr(97 + i)}]\n" for i in range(20)
)
DECEIVING = {
    "a bomb of aliases": ("c.yaml", BOMB.encode()),
    "a tag that runs": ("c.yaml", b"!!python/object/apply:os.system ['echo']\n"),
    "deep lists": ("c.yaml", b"[" * 100_000),
    "deep mappings": ("c.yaml", b"".join(b" " * i + b"a:\n" for i in range(500))),
    "many keys": ("c.yaml", b"".join(b"k%d: 1\n" % i for i in range(200_000))),
    "one long number": ("c.txt", b"9" * 5_000_000),
    "many numbers": ("c.txt", b"1 " * 2_000_000),
    "a long line": ("c.txt", b"a" * 5_000_000),
    "one long key": ("c.txt", b"a:" * 2_000_000),
    "many rows": ("c.csv", b"fx,fy,cx,cy\n" + b"1,1,1,1\n" * 200_000 + b"1,1,1\n"),
    "binary": ("c.txt", bytes(range(256)) * 100),
    "UTF-16": ("c.txt", "525 525 320 240".encode("utf-16")),
}


@pytest.mark.parametrize("case", DECEIVING)
def test_files_made_to_deceive_are_refused_in_time(tmp_path: Path, case: str) -> None:
    name, data = DECEIVING[case]
    path = tmp_path / name
    path.write_bytes(data)
    with limited_time(), pytest.raises(CameraError, match=r"c\.\w+(:\d+)?: expected") as caught:
        camera_from_file(path)
    assert len(str(caught.value)) < 1000
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "zeros without end"])
def test_what_is_no_file_does_not_keep_a_reader_waiting(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "c.yaml"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero" if kind == "zeros without end" else "/dev/tty")
    with limited_time(), pytest.raises(CameraError, match=r"c\.yaml: expected"):
        numbers_from_file(path, CameraSource())


def test_a_file_of_a_terabyte_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "c.txt"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    tracemalloc.start()
    with limited_time(), pytest.raises(CameraError, match="of at most"):
        camera_from_file(path)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
