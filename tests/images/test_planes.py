"""One image of any kind of file: arrays in containers, bare numbers, EXR, by their layouts."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import OpenEXR
import pytest

from nimprep.errors import DecodeError
from nimprep.images import Layout, Raw, read_header, read_plane
from tests.hostile.pictures import encoded
from tests.processes import PATIENCE_S

H, W, N = 6, 8, 5
MM = (1000 + 10 * np.arange(H * W)).reshape(H, W).astype(np.uint16)
MANY = np.stack([MM + 1000 * k for k in range(N)]).astype(np.float32)


def exr(path: Path, channels: dict[str, Any]) -> Path:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(path))
    return path


def check(path: Path, layout: Layout, wanted: np.ndarray, index: int | None = None) -> None:
    """Check what a file's image is, and that its header says the same."""
    found = read_plane(path, layout, index)
    assert found.dtype == wanted.dtype
    assert found.dtype.isnative
    assert found.flags.c_contiguous
    assert np.array_equal(found, wanted)
    header = read_header(path, layout)
    assert (header.height, header.width) == wanted.shape[:2]


@pytest.mark.parametrize(
    "dtype", ["u1", "i1", "<u2", ">u2", "<i2", ">i4", "<u4", "<i8", "<u8", "<f2", ">f4", "<f8", "?"]
)
@pytest.mark.parametrize("shape", [(H, W), (H, W, 1), (H, W, 3)])
def test_an_array_of_any_number_is_an_image(
    tmp_path: Path, dtype: str, shape: tuple[int, ...]
) -> None:
    array = (np.arange(np.prod(shape)) % 100).reshape(shape).astype(dtype)
    np.save(tmp_path / "a.npy", array)
    wanted = array[..., 0] if shape[2:] == (1,) else array
    wanted = wanted.view("u1") if dtype == "?" else wanted.astype(wanted.dtype.newbyteorder("="))
    check(tmp_path / "a.npy", Layout(), wanted)


ORDERS = ["NHW", "NWH", "HWN", "WHN", "HNW"]


@pytest.mark.parametrize("axes", ORDERS)
@pytest.mark.parametrize("ending", ["npy", "columns.npy", "npz", "packed.npz", "h5", "chunked.h5"])
def test_each_frame_of_many_is_read_whatever_the_order(
    tmp_path: Path, axes: str, ending: str
) -> None:
    path = tmp_path / f"a.{ending}"
    array = MANY.transpose(["NHW".index(a) for a in axes])
    if ending.endswith("npy"):
        np.save(path, np.asarray(array, order="F" if "columns" in ending else "C"))
    elif ending.endswith("npz"):
        save = np.savez_compressed if "packed" in ending else np.savez
        save(path, depths=array, other=np.zeros(3))
    else:
        with h5py.File(path, "w") as file:
            options = {"chunks": (2, 3, 4), "compression": "gzip", "shuffle": True}
            file.create_dataset("a/depths", data=array, **(options if "chunked" in ending else {}))
    key = {"npz": "depths", ".h5": "a/depths"}.get(path.name[-3:])
    layout = Layout(axes=axes, key=key)
    assert read_header(path, layout).frames == N
    for k in range(N):
        check(path, layout, MANY[k], k)
    with pytest.raises(DecodeError, match=f"expected frame {N}, found {N} frames"):
        read_plane(path, layout, N)
    with pytest.raises(DecodeError, match="expected a file of one frame"):
        read_plane(path, layout)


def test_matlab_7_3_is_read_with_its_axes_turned(tmp_path: Path) -> None:
    path = tmp_path / "nyu.mat"
    rgb = np.stack([np.dstack([MM % 251, MM % 13, MM % 7])] * 2).astype(np.uint8)
    with h5py.File(path, "w", userblock_size=512) as file:
        file["images"] = rgb.transpose(0, 3, 2, 1)
    data = bytearray(path.read_bytes())
    data[:19] = b"MATLAB 7.3 MAT-file"
    path.write_bytes(data)
    layout = Layout(key="images", axes="NCWH")
    assert read_header(path, layout).frames == 2
    assert read_header(path, layout).channels == 3
    check(path, layout, rgb[1], 1)


def test_a_container_with_one_array_needs_no_key(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", MM)
    check(tmp_path / "a.npz", Layout(), MM)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["depth"] = MM
        file.create_group("group")
    check(tmp_path / "a.h5", Layout(), MM)


@pytest.mark.parametrize("name", ["a.npz", "a.h5"])
@pytest.mark.parametrize("key", [None, "nothing"])
def test_a_key_that_does_not_tell_gets_the_names_there_are(
    tmp_path: Path, name: str, key: str | None
) -> None:
    path = tmp_path / name
    if name == "a.npz":
        np.savez(path, one=MM, two=MM)
    else:
        with h5py.File(path, "w") as file:
            file["one"] = file["two"] = MM
    with pytest.raises(DecodeError, match="found 'one', 'two'; name the one that counts as 'key'"):
        read_plane(path, Layout(key=key))


@pytest.mark.parametrize("order", ["little", "big", "swapped", None])
@pytest.mark.parametrize("header_bytes", [0, 16])
def test_bare_numbers_are_read_as_described(tmp_path: Path, order: Any, header_bytes: int) -> None:
    path = tmp_path / "a.bin"
    numbers = MM.astype(">u2" if order in ("big", "swapped") else "<u2")
    path.write_bytes(bytes(header_bytes) + numbers.tobytes())
    raw = Raw(dtype="uint16", width=W, height=H, header_bytes=header_bytes)
    check(path, Layout(raw=raw, byte_order=order), MM)


def test_bare_numbers_may_be_many_frames_or_channels(tmp_path: Path) -> None:
    path = tmp_path / "a.raw"
    path.write_bytes(MANY.astype("<f4").tobytes())
    raw = Raw(dtype="float32", width=W, height=H)
    layout = Layout(raw=raw, axes="NHW")
    assert read_header(path, layout).frames == N
    check(path, layout, MANY[3], 3)
    colors = np.dstack([MM % 251, MM % 13, MM % 7]).astype(np.uint8)
    raw = Raw(dtype="uint8", width=W, height=H, channels=3)
    path.write_bytes(colors.tobytes())
    check(path, Layout(raw=raw), colors)
    check(path, Layout(raw=raw, channel=1), colors[:, :, 1])
    path.write_bytes(np.moveaxis(colors, 2, 0).tobytes())
    check(path, Layout(raw=raw, axes="CHW"), colors)


@pytest.mark.parametrize("size", [0, 2 * H * W - 1, 2 * H * W + 1, 4 * H * W])
def test_bare_numbers_of_another_size_are_refused(tmp_path: Path, size: int) -> None:
    (tmp_path / "a.bin").write_bytes(bytes(size))
    layout = Layout(raw=Raw(dtype="uint16", width=W, height=H))
    for read in (read_plane, read_header):
        with pytest.raises(DecodeError, match=rf"expected 96 bytes .*, found {size} in all; mend"):
            read(tmp_path / "a.bin", layout)


def test_image_files_have_their_channels_in_order(tmp_path: Path) -> None:
    colors = np.dstack([MM % 251, MM % 13, MM % 7, MM % 5]).astype(np.uint8)
    path = tmp_path / "a.png"
    path.write_bytes(encoded(".png", colors[:, :, [2, 1, 0, 3]]))
    check(path, Layout(), colors)
    for number, letter in enumerate("RGBA"):
        check(path, Layout(channel=letter), colors[:, :, number])
        check(path, Layout(channel=number), colors[:, :, number])
    path.write_bytes(encoded(".png", colors[:, :, 2::-1]))
    with pytest.raises(DecodeError, match="expected a channel 'A', found 3 channels; mend"):
        read_plane(path, Layout(channel="A"))


def test_swapped_bytes_are_swapped_back(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(encoded(".png", MM.byteswap()))
    check(path, Layout(byte_order="swapped"), MM)
    np.save(tmp_path / "a.npy", MM.byteswap())
    check(tmp_path / "a.npy", Layout(byte_order="swapped"), MM)


def test_an_array_that_says_another_byte_order_than_its_description_is_refused(
    tmp_path: Path,
) -> None:
    for mark, said, other in (("<", "little", "big"), (">", "big", "little")):
        np.save(tmp_path / "a.npy", MM.astype(f"{mark}u2"))
        check(tmp_path / "a.npy", Layout(byte_order=said), MM)
        with pytest.raises(DecodeError, match=f"expected {other}-endian .*leave 'byte_order' out"):
            read_plane(tmp_path / "a.npy", Layout(byte_order=other))


@pytest.mark.parametrize("kind", ["f2", "f4", "u4"])
@pytest.mark.parametrize("name", ["Z", "Y", "anything"])
def test_the_one_channel_of_an_exr_is_read_as_it_is(tmp_path: Path, kind: str, name: str) -> None:
    plane = MM.astype(kind)
    if kind != "u4":
        plane[0, :3] = (np.inf, np.nan, -np.inf)
    path = exr(tmp_path / "a.exr", {name: plane})
    found = read_plane(path)
    assert found.dtype == plane.dtype
    assert np.array_equal(found, plane, equal_nan=kind != "u4")
    assert (read_header(path).height, read_header(path).width) == (H, W)


def test_channels_of_an_exr_are_named_or_colours(tmp_path: Path) -> None:
    plane = MM.astype(np.float32)
    path = exr(tmp_path / "a.exr", {"Z": plane, "R": plane + 1, "G": plane + 2, "B": plane + 3})
    check(path, Layout(key="Z"), plane)
    with pytest.raises(DecodeError, match="found 'B', 'G', 'R', 'Z'; name the one that counts"):
        read_header(path)
    path = exr(tmp_path / "b.exr", {"R": plane + 1, "G": plane + 2, "B": plane + 3})
    check(path, Layout(), np.dstack([plane + 1, plane + 2, plane + 3]))
    check(path, Layout(channel="G"), plane + 2)


@pytest.mark.parametrize(
    "layout", [Layout(key="a"), Layout(axes="NHW"), Layout(byte_order="big")], ids=str
)
def test_what_only_arrays_have_is_refused_of_image_files(tmp_path: Path, layout: Layout) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(encoded(".png", MM))
    for read in (read_plane, read_header):
        with pytest.raises(DecodeError, match=r"expected an array, as the descr.*; leave"):
            read(path, layout)


@pytest.mark.parametrize(
    ("shape", "axes", "found"),
    [
        ((5, 6, 80), None, "describe its 'axes'"),
        ((5, 6, 8, 3), None, "describe its 'axes'"),
        ((48,), None, "describe its 'axes'"),
        ((6, 8), "NHW", "mend 'axes'"),
        ((6, 8), "HH", "one H and one W"),
        ((5, 6, 80), "HWC", "at most 16 channels"),
        ((0, 8), None, "1 to"),
    ],
)
def test_a_shape_that_is_no_images_is_refused(
    tmp_path: Path, shape: tuple[int, ...], axes: str | None, found: str
) -> None:
    np.save(tmp_path / "a.npy", np.zeros(shape, np.uint8))
    for read in (read_plane, read_header):
        with pytest.raises(DecodeError, match=found):
            read(tmp_path / "a.npy", Layout(axes=axes))


_IN_A_CHILD = """
import os, sys
from pathlib import Path
from nimprep.images import read_plane
paths = [Path(name) for name in sys.argv[1:]]
wanted = [float(read_plane(path).sum()) for path in paths]
child = os.fork()
if child == 0:
    os._exit([float(read_plane(path).sum()) for path in paths] != wanted)
assert os.waitpid(child, 0)[1] == 0
"""


def test_containers_are_read_after_a_fork(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["depth"] = MM
    paths = (tmp_path / "a.h5", exr(tmp_path / "a.exr", {"Z": MM.astype(np.float32)}))
    command = [sys.executable, "-c", _IN_A_CHILD, *map(str, paths)]
    subprocess.run(command, check=True, timeout=PATIENCE_S)


def test_a_frame_of_a_file_larger_than_is_read_at_once_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nimprep.images.array.MAX_BYTES", 2 * MANY[0].nbytes)
    np.save(tmp_path / "a.npy", MANY)
    check(tmp_path / "a.npy", Layout(axes="NHW"), MANY[4], 4)
    np.save(tmp_path / "b.npy", MANY.transpose(1, 2, 0))
    with pytest.raises(DecodeError, match="more than is read at once"):
        read_plane(tmp_path / "b.npy", Layout(axes="HWN"), 4)


def test_float_tiffs_stay_as_they_are(tmp_path: Path) -> None:
    data = cv2.imencode(".tif", MM.astype(np.float32))[1].tobytes()
    (tmp_path / "a.tif").write_bytes(data)
    check(tmp_path / "a.tif", Layout(), MM.astype(np.float32))


@pytest.mark.parametrize(
    ("module", "extra", "name"), [("h5py", "hdf5", "a.h5"), ("OpenEXR", "exr", "a.exr")]
)
def test_a_file_without_its_extra_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, extra: str, name: str
) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["depth"] = MM
    exr(tmp_path / "a.exr", {"Z": MM.astype(np.float32)})
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DecodeError, match=rf"found none; .* pip install 'nimprep\[{extra}\]'"):
        read_plane(tmp_path / name)


@pytest.mark.parametrize("layout", [Layout(key="depth"), Layout(axes="HWN"), Layout(key="a/b")])
def test_a_file_that_is_neither_array_nor_image_says_what_it_is(
    tmp_path: Path, layout: Layout
) -> None:
    path = tmp_path / "m.mat"
    path.write_bytes(b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + bytes(200))
    with pytest.raises(
        DecodeError, match=r"found a MATLAB 5 file, .*; save it by save\(..., '-v7.3'"
    ):
        read_plane(path, layout)


@pytest.mark.parametrize("key", [None, "camera", "camera/rgb", "other/depth"])
def test_the_arrays_of_an_hdf5_file_are_named_with_their_groups(
    tmp_path: Path, key: str | None
) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["camera/left/depth"] = MM
        file["camera/depth"] = MM
        file["loop"] = file["camera"]
        file["camera/loop"] = file["/"]
    with pytest.raises(DecodeError, match=r"found 'camera/depth', 'camera/left/depth', .*as 'key'"):
        read_plane(tmp_path / "a.h5", Layout(key=key))
