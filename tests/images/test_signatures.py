"""Files of formats that are not read: named by how they start, with what to do."""

from __future__ import annotations

import gzip
import io
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from nimprep.errors import DecodeError
from nimprep.images import read_depth, read_header, read_label, read_plane, read_rgb

IMAGE = PIL.Image.new("RGB", (8, 6), (1, 2, 3))


def written(kind: str, **options: object) -> bytes:
    file = io.BytesIO()
    IMAGE.save(file, kind, **options)
    return file.getvalue()


def archived(kind: str) -> bytes:
    file = io.BytesIO()
    if kind == "zip":
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("a.png", b"x")
    else:
        with tarfile.open(fileobj=file, mode="w") as tar:
            tar.addfile(tarfile.TarInfo("a.png"))
    return file.getvalue()


def saved(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def boxed(brand: bytes) -> bytes:
    return b"\0\0\0\x18ftyp" + brand + bytes(200)


FORMATS = {
    "a GIF": (written("GIF"), "convert it to PNG"),
    "a JPEG 2000": (b"\0\0\0\x0cjP  \r\n\x87\n" + bytes(50), "convert it to PNG"),
    "a HEIC": (boxed(b"heic"), "convert it to PNG"),
    "an AVIF": (boxed(b"avif"), "convert it to PNG"),
    "a video (MP4 or QuickTime)": (boxed(b"isom"), "write its frames as PNG"),
    "a video (AVI)": (b"RIFF\0\0\0\0AVI LIST" + bytes(50), "write its frames as PNG"),
    "a video (Matroska)": (b"\x1a\x45\xdf\xa3" + bytes(50), "write its frames as PNG"),
    "a zip file": (archived("zip"), "unpack it first, or name it .npz"),
    "a tar file": (archived("tar"), "unpack it first"),
    "a gzip file": (gzip.compress(b"x" * 100), "unpack it first"),
    "a MATLAB 5 file": (b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + bytes(200), "'-v7.3'"),
    "a Photoshop file": (b"8BPS\0\1" + bytes(50), "convert it to PNG"),
    "a Radiance HDR": (b"#?RADIANCE\n\n-Y 6 +X 8\n", "convert it to EXR or"),
    "a DICOM file": (bytes(128) + b"DICM" + bytes(50), "convert it to 16-bit PNG"),
    "a pointer of Git LFS": (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
    "a web page": (b"<!DOCTYPE html><html>", "download the file anew"),
    "nothing but zeros": (bytes(1000), "it was cut while it was copied"),
    "a PDF": (written("PDF"), "convert it to PNG"),
}


@pytest.mark.parametrize("name", FORMATS)
def test_a_format_that_is_not_read_is_named_with_a_next_step(tmp_path: Path, name: str) -> None:
    data, step = FORMATS[name]
    path = tmp_path / "a.png"
    path.write_bytes(data)
    for read in (read_header, read_rgb, read_depth, read_label, read_plane):
        with pytest.raises(DecodeError) as caught:
            read(path)
        found = f"found {name}, which is not read here; "
        assert f"{path}: expected an image" in str(caught.value)
        assert found in str(caught.value)
        assert step in str(caught.value).partition(found)[2]


def test_a_numpy_array_and_hdf5_are_no_colour_image_and_told_so(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(saved(np.zeros((6, 8), np.uint8)))
    assert read_plane(path).shape == (6, 8)
    with pytest.raises(DecodeError, match=r"found a NumPy array, which .* here; name it \.npy"):
        read_rgb(path)
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(600))
    with pytest.raises(DecodeError, match=r"found an HDF5 file, which .*; read it as depth"):
        read_rgb(path)
    with pytest.raises(DecodeError, match=r"a\.png: expected a whole HDF5 file"):
        read_plane(path)


def test_what_nobody_knows_is_told_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"\1\2\3\4" * 10)
    with pytest.raises(DecodeError, match="found 40 bytes that are none; describe bare numbers by"):
        read_header(path)
