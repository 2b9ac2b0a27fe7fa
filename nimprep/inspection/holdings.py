"""Files that hold many images, or other things than images: archives, recordings, containers."""

from __future__ import annotations

import re
import sqlite3
import tarfile
import zipfile
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from nimprep.errors import DecodeError
from nimprep.files import open_plain, read_start

HoldingKind = Literal["archive", "recording", "container", "points", "image", "other"]

_MOST_NAMES = 400
_TAIL = 1 << 21


@dataclass(frozen=True)
class Holding:
    """Say what a file is that is no image nimprep reads.

    Attributes
    ----------
    path : Path
    kind : str
        "archive", "recording", "container", "points", "image", "other".
    what : str
        For people.
    names : tuple of str
        Of files in an archive, topics of a recording, arrays of a container.
    step : str
        What to do with it.
    """

    path: Path
    kind: HoldingKind
    what: str
    names: tuple[str, ...] = ()
    step: str = ""


_UNPACK = "unpack it, then inspect the folder"
_EXPORT = "recordings are not converted yet; export colour and depth to images first"
_TO_PNG = "convert it to PNG, TIFF or .npy first"

_SIGNATURES: tuple[tuple[int, bytes, HoldingKind, str, str], ...] = (
    (0, b"PK\x03\x04", "archive", "a zip archive", _UNPACK),
    (0, b"PK\x05\x06", "archive", "an empty zip archive", _UNPACK),
    (0, b"7z\xbc\xaf\x27\x1c", "archive", "a 7z archive", _UNPACK),
    (0, b"Rar!\x1a\x07", "archive", "a RAR archive", _UNPACK),
    (0, b"\x1f\x8b", "archive", "a gzip archive", _UNPACK),
    (0, b"BZh", "archive", "a bzip2 archive", _UNPACK),
    (0, b"\xfd7zXZ\0", "archive", "an xz archive", _UNPACK),
    (0, b"\x28\xb5\x2f\xfd", "archive", "a Zstandard archive", _UNPACK),
    (257, b"ustar", "archive", "a tar archive", _UNPACK),
    (0, b"#ROSBAG V2.0", "recording", "a ROS 1 bag", _EXPORT),
    (0, b"\x89MCAP0\r\n", "recording", "an MCAP recording", _EXPORT),
    (0, b"SQLite format 3\0", "other", "an SQLite database", ""),
    (0, b"\x89HDF\r\n\x1a\n", "container", "an HDF5 file", ""),
    (512, b"\x89HDF\r\n\x1a\n", "container", "a MATLAB v7.3 file", ""),
    (
        0,
        b"MATLAB 5.0",
        "container",
        "a MATLAB v5 file",
        "save its arrays as .npy, or with -v7.3, first",
    ),
    (4, b"ftypheic", "image", "HEIC", _TO_PNG),
    (4, b"ftypheix", "image", "HEIC", _TO_PNG),
    (4, b"ftypmif1", "image", "HEIF", _TO_PNG),
    (4, b"ftypavif", "image", "AVIF", _TO_PNG),
    (4, b"ftyp", "recording", "an MP4 video", "videos are not converted; export frames to images"),
    (0, b"\x1a\x45\xdf\xa3", "recording", "a Matroska video (Azure Kinect's too)", _EXPORT),
    (8, b"AVI ", "recording", "an AVI video", "videos are not converted; export frames to images"),
    (0, b"\x76\x2f\x31\x01", "image", "OpenEXR", _TO_PNG),
    (0, b"GIF8", "image", "GIF", _TO_PNG),
    (0, b"ply\n", "points", "a PLY point cloud or mesh", ""),
    (0, b"ply\r\n", "points", "a PLY point cloud or mesh", ""),
    (0, b"# .PCD", "points", "a PCD point cloud", ""),
    (0, b"LASF", "points", "a LAS point cloud", ""),
    (0, b"PAR1", "other", "a Parquet table", "export its images to files first"),
)

_ENDINGS: dict[str, tuple[HoldingKind, str, str]] = {
    ".svo": ("recording", "a ZED recording", _EXPORT),
    ".svo2": ("recording", "a ZED recording", _EXPORT),
    ".oni": ("recording", "an OpenNI recording", _EXPORT),
    ".tfrecord": ("other", "TensorFlow records", "export their images to files first"),
    ".pkl": ("other", "a Python pickle, which is never loaded", "save arrays as .npy instead"),
    ".pt": ("other", "a PyTorch file, which is never loaded", "save arrays as .npy instead"),
}


def holding_at(path: Path) -> Holding | None:
    """Return what a file is by its first bytes, else by its ending; None = nothing known.

    Raises
    ------
    DecodeError
        It cannot be read.
    """
    start = read_start(path, 600)
    for place, signature, kind, what, step in _SIGNATURES:
        if start[place : place + len(signature)] == signature:
            return _told(Holding(path, kind, what, step=step))
    if start.startswith(b"RIFF") or not start:
        return None
    if path.name == "metadata.yaml" and b"rosbag2_bagfile_information" in start:
        return Holding(path, "recording", "a rosbag2 recording", _topics(start), _EXPORT)
    if path.suffix.lower() in _ENDINGS:
        kind, what, step = _ENDINGS[path.suffix.lower()]
        return Holding(path, kind, what, step=step)
    return None


def _topics(text: bytes) -> tuple[str, ...]:
    return tuple(name.decode() for name in re.findall(rb"name: (/[\w/]+)", text))


def _told(holding: Holding) -> Holding:
    """Return a holding with the names of what is in it, where that is cheap to say."""
    path, what = holding.path, holding.what
    if path.suffix.lower() == ".r3d":
        return Holding(path, "recording", "a Record3D recording", _zip_names(path), _EXPORT)
    if what == "an SQLite database":
        topics = _database_topics(path)
        if not topics:
            return holding
        return Holding(path, "recording", _recording(topics, "rosbag2, SQLite"), topics, _EXPORT)
    listed: dict[str, Callable[[Path], tuple[str, ...]]] = {
        "a zip archive": _zip_names,
        "a ROS 1 bag": lambda p: _found(p, rb"topic=(/[\w/]+)"),
        "an MCAP recording": lambda p: _found(p, rb"(/[\w/]+)[\x03\x04]\0\0\0(?:cdr|ros1)"),
        "an HDF5 file": array_names,
        "a MATLAB v7.3 file": array_names,
    }
    if holding.kind == "archive" and (".tar" in path.name.lower() or path.suffix == ".tgz"):
        return Holding(path, "archive", what, _tar_names(path), holding.step)
    if what not in listed:
        return holding
    names = listed[what](path)
    if holding.kind == "recording":
        what = _recording(names, what)
    return Holding(path, holding.kind, what, names, holding.step)


def _recording(topics: tuple[str, ...], what: str) -> str:
    if any(topic.startswith("/device_0/") for topic in topics):
        return f"a RealSense recording ({what})"
    return what if what.startswith("a") else f"a recording ({what})"


def _zip_names(path: Path) -> tuple[str, ...]:
    try:
        with zipfile.ZipFile(path) as archive:
            return tuple(archive.namelist()[:_MOST_NAMES])
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError, UnicodeError):
        return ()


def _tar_names(path: Path) -> tuple[str, ...]:
    """Return the first names in a tar archive; compressed ones are read no further than those."""
    names: list[str] = []
    with suppress(tarfile.TarError, OSError, EOFError, ValueError), tarfile.open(path) as archive:
        for member in archive:
            names.append(member.name)
            if len(names) >= 50:
                break
    return tuple(names)


def _found(path: Path, pattern: bytes) -> tuple[str, ...]:
    """Return what a pattern finds in a file's end and beginning, each once."""
    names: dict[str, None] = {}
    with suppress(DecodeError), open_plain(path) as (file, size):
        for place in (max(0, size - _TAIL), 0):
            file.seek(place)
            for match in re.finditer(pattern, file.read(_TAIL)):
                names[match[1].decode("ascii", "replace")] = None
    return tuple(names)[:_MOST_NAMES]


def _database_topics(path: Path) -> tuple[str, ...]:
    address = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
    try:
        with closing(sqlite3.connect(address, uri=True)) as database:
            rows = database.execute("SELECT name FROM topics LIMIT 400").fetchall()
    except sqlite3.Error:
        return ()
    return tuple(str(name) for (name,) in rows)


def array_names(path: Path) -> tuple[str, ...]:
    """Return the arrays of an HDF5 file with shape and type; empty without h5py."""
    try:
        import h5py
    except ImportError:
        return ()
    names: list[str] = []

    def visit(name: str, item: object) -> bool | None:
        if isinstance(item, h5py.Dataset):
            names.append(f"{name} {tuple(item.shape)} {item.dtype}")
        return True if len(names) >= _MOST_NAMES else None

    with suppress(OSError, RuntimeError, ValueError, KeyError), h5py.File(path, "r") as file:
        file.visititems(visit)
    return tuple(names)
