"""Archives, HDF5 and EXR files: damaged anywhere, or made to deceive."""

from __future__ import annotations

import io
import os
import struct
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import OpenEXR
import pytest
from hypothesis import strategies as st

from nimprep.errors import DecodeError
from nimprep.images import Layout, Raw, read_header, read_plane
from tests.hostile.damage import damaged
from tests.hostile.fuzzing import fuzz, limited_memory, limited_time, survives
from tests.hostile.pictures import npy, npy_of, picture

DEPTH = picture("uint16", 1)
KEY = Layout(key="depth")


def zipped(member: bytes, *, name: str = "depth.npy", packed: bool = True) -> bytes:
    """Return an archive of one member."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED if packed else 0) as archive:
        archive.writestr(name, member)
    return file.getvalue()


def claiming(data: bytes, size: int, packed: int | None = None) -> bytes:
    """Return an archive whose directory says another size of its only member."""
    place = data.rindex(b"PK\1\2")
    was = struct.unpack_from("<I", data, place + 20)[0]
    sizes = struct.pack("<II", was if packed is None else packed, size)
    return data[: place + 20] + sizes + data[place + 28 :]


def header_of(shape: object, descr: str = "<f4") -> bytes:
    return npy_of(f"{{'descr': {descr!r}, 'fortran_order': False, 'shape': {shape}, }}\n")


@cache
def hdf5_of(make: Callable[[h5py.File], object]) -> bytes:
    file = io.BytesIO()
    with h5py.File(file, "w") as made:
        make(made)
    return file.getvalue()


def whole(file: h5py.File) -> None:
    file.create_dataset("depth", data=DEPTH, chunks=(8, 8), compression="gzip")


@cache
def exr_bytes() -> bytes:
    file = io.BytesIO()
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Z": DEPTH.astype(np.float32)}).write(file)
    return file.getvalue()


BAD_ARCHIVES = {
    "a gigabyte of zeros": zipped(header_of((16384, 16384)) + bytes(1 << 20)),
    "more pixels than are read": zipped(header_of((1 << 16, 1 << 16))),
    "a member said to be larger": claiming(zipped(header_of((24, 32))), 1 << 30),
    "more than can be packed": claiming(zipped(header_of((4096, 4096)) + bytes(1000)), 1 << 27),
    "less than said": claiming(zipped(header_of((24, 32)) + bytes(100)), 24 * 32 * 4 + 200),
    "nothing of a stored member": claiming(zipped(npy(DEPTH)[:100], packed=False), 2000, 2000),
    "objects": zipped(npy(np.full((2, 2), None), pickled=True)),
    "another method": zipped(npy(DEPTH)).replace(b"\x08\0", b"\x0e\0"),
    "no array": zipped(npy(DEPTH), name="depth.txt"),
    "an encrypted member": zipped(npy(DEPTH)).replace(b"\0\0\x08\0", b"\1\0\x08\0"),
    "a directory that is cut": zipped(npy(DEPTH))[:-30],
    "a bomb for a header": zipped(b"\x93NUMPY\2\0\xff\xff\xff\x7f" + bytes(1 << 20)),
    "nothing": b"",
}


@pytest.mark.parametrize("case", BAD_ARCHIVES)
def test_an_archive_made_to_deceive_is_refused(tmp_path: Path, case: str) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(BAD_ARCHIVES[case])
    with limited_memory(1 << 28), limited_time(), pytest.raises(DecodeError, match=r"a\.npz: exp"):
        read_plane(path, KEY)
    survives("containers, made to deceive", lambda: read_header(path, KEY))


def test_a_frame_far_into_a_packed_archive_costs_no_memory_for_those_before(tmp_path: Path) -> None:
    path, frames = tmp_path / "a.npz", 40_000
    path.write_bytes(zipped(header_of((frames, 16, 32)) + bytes(4 * 16 * 32 * frames)))
    layout = Layout(key="depth", axes="NHW")
    with limited_memory(1 << 25), limited_time():
        assert not read_plane(path, layout, frames - 1).any()


def _linked(file: h5py.File) -> None:
    file["depth"] = h5py.ExternalLink("/etc/passwd", "depth")


def _elsewhere(file: h5py.File) -> None:
    file.create_dataset("depth", (24, 32), "u2", external=[("/etc/passwd", 0, 24 * 32 * 2)])


def _virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((24, 32), "u2")
    layout[:] = h5py.VirtualSource("/other.h5", "depth", (24, 32))
    file.create_virtual_dataset("depth", layout)


def _looped(file: h5py.File) -> None:
    file["depth"] = h5py.SoftLink("/depth")


BAD_HDF5: dict[str, Callable[[h5py.File], object]] = {
    "a link to another file": _linked,
    "numbers in another file": _elsewhere,
    "numbers put together of other files": _virtual,
    "a link to itself": _looped,
    "a petabyte that is not there": lambda f: f.create_dataset(
        "depth", (1 << 25, 1 << 25), "u1", chunks=(64, 64)
    ),
    "a chunk of a gigabyte": lambda f: f.create_dataset(
        "depth", (24, 32), "u1", chunks=(1 << 15, 1 << 15), maxshape=(None, None)
    ),
    "texts": lambda f: f.create_dataset("depth", data=["a", "b"]),
    "records": lambda f: f.create_dataset("depth", data=np.zeros((24, 32), [("z", "<f4")])),
    "nothing": lambda f: f.create_dataset("depth", data=h5py.Empty("f4")),
    "a number": lambda f: f.create_dataset("depth", data=5.0),
    "a group": lambda f: f.create_group("depth"),
}


@pytest.mark.parametrize("case", BAD_HDF5)
def test_an_hdf5_file_made_to_deceive_is_refused(tmp_path: Path, case: str) -> None:
    path = tmp_path / "a.h5"
    path.write_bytes(hdf5_of(BAD_HDF5[case]))
    with limited_memory(1 << 28), limited_time(), pytest.raises(DecodeError, match=r"a\.h5: exp"):
        read_plane(path, KEY)
    survives("containers, made to deceive", lambda: read_header(path, KEY))


EXR_SIZE = exr_bytes().index(b"dataWindow\0box2i\0") + 21
BAD_EXRS = {
    "a size of 2**31": exr_bytes()[:EXR_SIZE]
    + struct.pack("<4i", -(1 << 30), 0, 1 << 30, 1 << 20)
    + exr_bytes()[EXR_SIZE + 16 :],
    "a negative size": exr_bytes()[:EXR_SIZE]
    + struct.pack("<4i", 5, 5, 0, 0)
    + exr_bytes()[EXR_SIZE + 16 :],
    "an attribute longer than the file": exr_bytes()[:8] + b"a\0b\0\xff\xff\xff\x7f" + bytes(20),
    "a header without an end": exr_bytes()[:8] + b"x" * 10_000,
    "deep": exr_bytes()[:5] + b"\x08" + exr_bytes()[6:],
    "many parts": exr_bytes()[:5] + b"\x10" + exr_bytes()[6:],
    "half": exr_bytes()[: len(exr_bytes()) // 2],
    "cut by a byte": exr_bytes()[:-1],
    "nothing but its start": exr_bytes()[:4],
}


@pytest.mark.parametrize("case", BAD_EXRS)
def test_an_exr_made_to_deceive_is_refused(
    tmp_path: Path, case: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.exr"
    path.write_bytes(BAD_EXRS[case])
    for read in (read_plane, read_header):
        with limited_time(), pytest.raises(DecodeError, match=r"a\.exr: expected"):
            read(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("size", [0, 10, 1 << 40])
def test_bare_numbers_of_a_size_that_cannot_be_are_refused(tmp_path: Path, size: int) -> None:
    path = tmp_path / "a.bin"
    path.touch()
    os.truncate(path, size)
    layout = Layout(raw=Raw(dtype="float64", width=65_536, height=65_536, channels=4))
    with limited_time(), pytest.raises(DecodeError, match=r"a\.bin: expected"):
        read_plane(path, layout)
    layout = Layout(raw=Raw(dtype="uint16", width=32, height=24), axes="NHW")
    survives("containers, bare numbers", lambda: read_plane(path, layout, 0))


SAMPLES = {
    "packed.npz": zipped(npy(DEPTH)),
    "stored.npz": zipped(npy(DEPTH), packed=False),
    "a.exr": exr_bytes(),
    "a.h5": hdf5_of(whole),
}


@st.composite
def containers(draw: st.DrawFn) -> tuple[str, bytes]:
    name = draw(st.sampled_from(sorted(SAMPLES)))
    return name, draw(damaged(SAMPLES[name]))


@fuzz(250, container=containers())
def test_any_damage_to_a_container_is_refused_or_gives_an_image(
    tmp_path: Path, container: tuple[str, bytes]
) -> None:
    name, data = container
    path = tmp_path / name
    path.write_bytes(data)
    layout = Layout() if name.endswith("exr") else KEY
    for read in (read_header, read_plane):
        survives(f"containers, .{name[-3:]}", lambda read=read: read(path, layout))


def test_an_hdf5_file_that_was_cut_is_refused(tmp_path: Path) -> None:
    path, data = tmp_path / "a.h5", hdf5_of(whole)
    for share in range(8):
        path.write_bytes(data[: len(data) * share // 8])
        with limited_time(), pytest.raises(DecodeError, match=r"a\.h5: expected"):
            read_plane(path, KEY)


@pytest.mark.parametrize("name", ["a.npz", "a.h5", "a.exr"])
def test_a_pipe_is_no_container(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with limited_time(), pytest.raises(DecodeError, match="found a pipe or a device"):
        read_plane(tmp_path / name, KEY)
