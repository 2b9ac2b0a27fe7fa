"""Files that are no image here, by how they start: what they are, and what to do."""

from __future__ import annotations

_CONVERT = "convert it to PNG"
_UNPACK = "unpack it first"
_FRAMES = "write its frames as PNG, for instance by ffmpeg"
_ARRAYS = "read it as depth or labels by a description that names the array as 'key'"

_STARTS: tuple[tuple[int, bytes, str, str], ...] = (
    (0, b"GIF8", "a GIF", _CONVERT),
    (8, b"AVI ", "a video (AVI)", _FRAMES),
    (8, b"WAVE", "a sound", "mend the description's pattern"),
    (0, b"\x1a\x45\xdf\xa3", "a video (Matroska)", _FRAMES),
    (0, b"\0\0\1\xba", "a video (MPEG)", _FRAMES),
    (0, b"FLV\1", "a video (FLV)", _FRAMES),
    (0, b"\xff\x0a", "a JPEG XL", _CONVERT),
    (4, b"JXL \r\n", "a JPEG XL", _CONVERT),
    (4, b"jP  \r\n", "a JPEG 2000", _CONVERT),
    (0, b"\xff\x4f\xff\x51", "a JPEG 2000", _CONVERT),
    (0, b"8BPS", "a Photoshop file", _CONVERT),
    (0, b"DDS ", "a DDS", _CONVERT),
    (0, b"#?R", "a Radiance HDR", "convert it to EXR or to a float32 TIFF"),
    (0, b"%PDF", "a PDF", _CONVERT),
    (0, b"<svg", "an SVG", _CONVERT),
    (128, b"DICM", "a DICOM file", "convert it to 16-bit PNG"),
    (0, b"\x89HDF\r\n\x1a\n", "an HDF5 file", _ARRAYS),
    (0, b"MATLAB 7.3", "a MATLAB 7.3 file", _ARRAYS),
    (0, b"MATLAB 5.0", "a MATLAB 5 file", "save it by save(..., '-v7.3'), or as .npy"),
    (0, b"\x93NUMPY", "a NumPy array", "name it .npy"),
    (0, b"\x76\x2f\x31\x01", "an EXR", "read it as depth or a plane"),
    (0, b"PK\3\4", "a zip file", f"{_UNPACK}, or name it .npz if it holds NumPy's arrays"),
    (0, b"PK\5\6", "an empty zip file", "get it anew"),
    (0, b"\x1f\x8b", "a gzip file", _UNPACK),
    (0, b"BZh", "a bzip2 file", _UNPACK),
    (0, b"\xfd7zXZ", "an xz file", _UNPACK),
    (0, b"\x28\xb5\x2f\xfd", "a Zstandard file", _UNPACK),
    (0, b"7z\xbc\xaf", "a 7z file", _UNPACK),
    (0, b"Rar!", "a RAR file", _UNPACK),
    (257, b"ustar", "a tar file", _UNPACK),
    (0, b"#ROSBAG", "a ROS bag", "write its images as files first"),
    (0, b"\x89MCAP", "an MCAP recording", "write its images as files first"),
    (0, b"SQLite format 3", "an SQLite file or ROS 2 bag", "write its images as files first"),
    (0, b"version https://git-lfs", "a pointer of Git LFS", "fetch the files by git lfs pull"),
    (0, b"<!DOCTYPE", "a web page", "download the file anew"),
    (0, b"<html", "a web page", "download the file anew"),
    (0, b"{", "a text, perhaps JSON", "mend the description's pattern"),
    (0, b"\x80\4\x95", "a pickle", "save it as .npy"),
    (0, b"ply\n", "a PLY point cloud", "project it into the image first"),
    (0, b"# .PCD", "a PCD point cloud", "project it into the image first"),
)

_BRANDS = {
    b"hei": ("a HEIC", _CONVERT),
    b"hev": ("a HEIC", _CONVERT),
    b"mif": ("a HEIC", _CONVERT),
    b"msf": ("a HEIC", _CONVERT),
    b"avi": ("an AVIF", _CONVERT),
}
"""Of ISO's base media format: all others are videos (MP4, QuickTime)."""

NEEDED = 512
"""So many first bytes tell."""


def unread_format(start: bytes) -> tuple[str, str] | None:
    """Return what a file is that is not read as an image, and what to do; None = nothing known.

    Parameters
    ----------
    start : bytes
        The file's first `NEEDED` bytes, or all of them.
    """
    if start[4:8] == b"ftyp":
        return _BRANDS.get(start[8:11], ("a video (MP4 or QuickTime)", _FRAMES))
    for place, signature, name, step in _STARTS:
        if start[place : place + len(signature)] == signature:
            return name, step
    if start[:1] == b"" or not start.strip(b"\0"):
        return "nothing but zeros", "get it anew: it was cut while it was copied"
    return None
