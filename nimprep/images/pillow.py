"""Headers of TIFF, BMP, WebP, PNM and PFM, as Pillow's parsers read them.

Not through `PIL.Image.open`: it warns of sizes that are read here, by a limit that belongs to the
whole process, and refuses kinds of TIFF that OpenCV reads.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable
from pathlib import Path

from nimprep.errors import DecodeError
from nimprep.frame import MAX_PIXELS
from nimprep.images.header import ImageHeader, broken

_TIFF_TAGS = {256: None, 257: None, 258: 1, 259: 1, 277: 1, 322: 1, 323: 1}
"""Width, height, bits, compression, channels, tile width and height: what they are if absent."""

_COMPRESSIONS = {1: "none", 5: "LZW", 7: "JPEG", 8: "deflate", 32773: "PackBits", 32946: "deflate"}
_MOST_CHANNELS = 4
_TIFF_WARNINGS = re.compile(r"PIL\.TiffImagePlugin")
_PNM_START = 1 << 12
_PFM_START = re.compile(rb"P[Ff]\s+\d+\s+\d+\s+[-+.\deE]+\s")


class _Metered(io.BytesIO):
    """A file that is not read over and over: tags of a TIFF may share bytes, and Pillow copies."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self._left = len(data) + (1 << 20)

    def read(self, size: int | None = -1, /) -> bytes:
        """Return the next bytes. Short pieces count as 256, for the time that they take."""
        part = super().read(size)
        self._left -= max(len(part), 256)
        if self._left < 0:
            raise ValueError("it says more than it has bytes")
        return part


def pillow_header(data: bytes, path: Path) -> ImageHeader:
    """Return what an image that starts with one of `SIGNATURES` says of itself.

    Raises
    ------
    DecodeError
        It is cut short or damaged, animated, or of a kind that is not read here.
    """
    name, parse = next(found for start, found in _FORMATS.items() if data.startswith(start))
    try:
        return parse(data, path)
    except (DecodeError, MemoryError, ImportError):
        raise
    except Exception as error:  # in files made to deceive, Pillow trips over anything
        reason = str(error) or type(error).__name__
        found = f"one of {len(data)} bytes that cannot be read: {reason}"
        raise broken(path, name, found) from error


def _tiff(data: bytes, path: Path) -> ImageHeader:
    width, height, bits, packing, channels, *tile = _first_directory(_Metered(data))
    header = ImageHeader(height, width, bits, "TIFF", channels)
    if packing not in _COMPRESSIONS:
        known = ", ".join(dict.fromkeys(_COMPRESSIONS.values()))
        raise DecodeError(f"{path}: expected a TIFF packed by {known}, found code {packing}")
    sane = 0 < channels <= _MOST_CHANNELS and 0 < bits <= 64
    if not sane or tile[0] * tile[1] > MAX_PIXELS:
        raise broken(path, "TIFF", f"{channels} channels of a {header} in tiles of {tile} pixels")
    return header


def _first_directory(file: io.BytesIO) -> list[int]:
    """Return the `_TIFF_TAGS` of the first image, which tell of its pixels as they are stored."""
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    # Odd tags are no news. `warnings.catch_warnings` would mix up the filters of threads.
    if not any(found[3] == _TIFF_WARNINGS for found in warnings.filters):
        warnings.filterwarnings("ignore", module=_TIFF_WARNINGS.pattern)
    start = file.read(8)
    big = b"+" in start[2:4]
    # Pillow tells BigTIFF by its magic number in little-endian order alone.
    magic = b"II+\0" if big else b"II*\0"
    directory = ImageFileDirectory_v2(magic + start[4:] + file.read(8 * big), start[:2])
    file.seek(directory.next)
    # Pillow only warns where it gives up, and then has not come to where the next image is.
    directory.next = -1
    directory.load(file)
    if directory.next < 0:
        raise ValueError("its directory is cut or damaged")
    found = []
    for tag, default in _TIFF_TAGS.items():
        value = directory.get(tag, default)
        # Bits are given for each channel.
        value = value[0] if isinstance(value, (tuple, bytes)) else value
        if not isinstance(value, int):
            raise ValueError(f"tag {tag} is {value!r:.40}")
        found.append(value)
    return found


def _bmp(data: bytes, path: Path) -> ImageHeader:
    """Return a BMP's size; its pixels become three or four channels of 8 bits."""
    from PIL.BmpImagePlugin import BmpImageFile

    image = BmpImageFile(_Metered(data))
    return ImageHeader(image.height, image.width, 8, "BMP", 4)


def _webp(data: bytes, path: Path) -> ImageHeader:
    from PIL.WebPImagePlugin import WebPImageFile

    image = WebPImageFile(_Metered(data))
    if image.n_frames > 1:
        raise broken(path, "WebP", "an animation")
    return ImageHeader(image.height, image.width, 8, "WebP", 4)


def _pnm(data: bytes, path: Path) -> ImageHeader:
    from PIL.PpmImagePlugin import PpmImageFile

    kind = data[:2]
    if (start := _PFM_START.match(data)) and b"\r" in start[0]:
        raise DecodeError(
            f"{path}: expected a PFM whose header's lines end in LF, "
            "found a header that ends in CR LF; write it in binary mode"
        )
    # Pillow has no PFM in colour, which differs by this letter alone.
    image = PpmImageFile(_Metered(kind.replace(b"F", b"f") + data[2:_PNM_START]))
    arguments = image.tile[0][3]
    bits = {"1": 1, "I": 16, "F": 32}.get(image.mode, 8)
    # The mode is RGB for 8 and for 16 bits.
    if image.mode == "RGB" and isinstance(arguments, tuple) and arguments[1] > 255:
        bits = 16
    channels = 3 if kind in (b"P3", b"P6", b"PF") else 1
    return ImageHeader(image.height, image.width, bits, "PNM", channels)


_FORMATS: dict[bytes, tuple[str, Callable[[bytes, Path], ImageHeader]]] = {
    **dict.fromkeys((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), ("TIFF", _tiff)),
    b"BM": ("BMP", _bmp),
    b"RIFF": ("WebP", _webp),
    **dict.fromkeys((b"P%c" % kind for kind in b"123456fF"), ("PNM", _pnm)),
}
SIGNATURES = tuple(_FORMATS)
