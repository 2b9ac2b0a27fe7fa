"""Cameras in plain text: bare numbers, and KITTI's lines of a name and a matrix.

KITTI's devkit has ``P2:`` with the 12 numbers of a projection, of the raw data ``K_02:``,
``D_02:``, ``S_02:`` and, once rectified, ``P_rect_02:`` and ``S_rect_02:``; ORFD has ``cam_K:``
with 9.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from nimprep.errors import CameraError
from nimprep.readers.camera_formats.numbers import (
    CameraNumbers,
    Intrinsics,
    intrinsics_of_matrix,
    is_matrix,
    numbers_of_text,
    size_of,
)
from nimprep.readers.description import CameraSource
from nimprep.readers.distortion import Distortion, distortion_from

_KEYED = re.compile(r"\s*([A-Za-z][\w.\[\]-]*)\s*[:=]\s*(\S.*?)\s*")
_CAMERA_NUMBER = re.compile(r"\d+$")
_LENS = re.compile(r"^(cam_)?D(_\d+)?$|dist", re.IGNORECASE)


def without_comments(text: str) -> str:
    """Return a text without its lines that begin with # or //."""
    kept = [s for s in text.splitlines() if not s.lstrip().startswith(("#", "//"))]
    return "\n".join(kept)


def numbers_of_bare(numbers: tuple[float, ...], where: str) -> CameraNumbers:
    """Return the camera of a file of numbers alone.

    4 are fx, fy, cx, cy; 9, 12 and 16 a matrix, row by row; 6 what of these is the one that can
    be: fx fy cx cy width height, width height fx fy cx cy, fx 0 cx 0 fy cy, or fx fy cx cy k1 k2.

    Raises
    ------
    CameraError
        They are not as many, no camera's matrix, or of 6 several could be meant.
    """
    if len(numbers) == 4:
        return CameraNumbers((numbers[0], numbers[1], numbers[2], numbers[3]), "4 numbers")
    if len(numbers) == 6:
        return _of_six(numbers, where)
    if len(numbers) not in (9, 12, 16):
        raise CameraError(
            f"{where}: expected 4, 6, 9, 12 or 16 numbers, found {len(numbers)}; "
            "give fx, fy, cx and cy in JSON"
        )
    return CameraNumbers(intrinsics_of_matrix(numbers, where), f"{len(numbers)} numbers")


def _of_six(numbers: tuple[float, ...], where: str) -> CameraNumbers:
    a, b, c, d, e, f = numbers
    found: list[CameraNumbers] = []
    for intrinsics, width, height in (((a, b, c, d), e, f), ((c, d, e, f), a, b)):
        size = size_of(width, height)
        fx, fy, cx, cy = intrinsics
        middle = width / 4 < cx < width * 3 / 4 and height / 4 < cy < height * 3 / 4
        if size and min(size) > 10 and min(fx, fy) > 0 and middle:
            found.append(CameraNumbers(intrinsics, "6 numbers", size))
    if b == d == 0 and min(a, e) > 0:
        found.append(CameraNumbers((a, e, c, f), "6 numbers"))
    elif min(a, b, c, d) > 0 and max(abs(e), abs(f)) < 10:
        lens = distortion_from(None, (e, f))
        found.append(CameraNumbers((a, b, c, d), "6 numbers", distortion=lens))
    if len(found) != 1:
        raise CameraError(
            f"{where}: expected 6 numbers of which two are a size, two are 0 or two are k1 and k2, "
            f"found {list(numbers)}; give fx, fy, cx and cy in JSON"
        )
    return found[0]


def keyed_lines(text: str) -> dict[str, str]:
    """Return what lines of a name, : or = and a text say; {} = some line is another."""
    found: dict[str, str] = {}
    for line in text.splitlines():
        keyed = _KEYED.fullmatch(line)
        if keyed is not None:
            found[keyed[1]] = keyed[2]
        elif line.strip():
            return {}
    return found


def keyed_numbers(lines: Mapping[str, str]) -> dict[str, tuple[float, ...]]:
    """Return the lines that are numbers alone."""
    made = {name: numbers_of_text(value) for name, value in lines.items()}
    return {name: numbers for name, numbers in made.items() if numbers is not None}


def has_matrices(numbers: Mapping[str, tuple[float, ...]]) -> bool:
    """Return whether a line is a matrix with which a camera can be told."""
    return any(len(values) in (9, 12, 16) for values in numbers.values())


def numbers_of_matrices(
    numbers: Mapping[str, tuple[float, ...]], where: str, source: CameraSource
) -> CameraNumbers:
    """Return the camera of KITTI-like lines: the one named by `source.key`, or the only one.

    Several matrices of one K are one camera. Of KITTI's four, P2 is the left colour camera, and its
    baseline is that to P3.

    Raises
    ------
    CameraError
        The line is not there or no camera's matrix, or several differ.
    """
    candidates = {name: v for name, v in numbers.items() if is_matrix(v)}
    if source.key is not None:
        if source.key not in numbers:
            raise CameraError(
                f"{where}: expected the matrix {source.key}, found "
                f"{', '.join(list(candidates)[:12]) or 'none'}; name another by camera.key"
            )
        name = source.key
        intrinsics = intrinsics_of_matrix(numbers[name], f"{where}: {name}")
    else:
        cameras = {name: intrinsics_of_matrix(v, where) for name, v in candidates.items()}
        if len(set(cameras.values())) != 1:
            raise CameraError(
                f"{where}: expected one camera's matrix, found "
                f"{', '.join(list(cameras)[:12]) or 'none'}; name one by the description's "
                "camera.key"
            )
        name = next((n for n in cameras if _number_in(n) == 2), next(iter(cameras)))
        intrinsics = cameras[name]
    return _with_neighbours(name, intrinsics, numbers, where)


def _with_neighbours(
    name: str, intrinsics: Intrinsics, numbers: Mapping[str, tuple[float, ...]], where: str
) -> CameraNumbers:
    """Add what other lines say of the same camera: its size, its distortion, its baseline."""
    number = _number_in(name)
    projection = len(numbers[name]) == 12
    ending = name.partition("_")[2]
    size = numbers.get(f"S_{ending}", ())
    lens: Distortion | None = None
    if not projection:
        lenses = {n: v for n, v in numbers.items() if _LENS.search(n)}
        own = {n: v for n, v in lenses.items() if _number_in(n) == number}
        lens = next((distortion_from(None, v) for v in own.values() if any(v)), None)
    baseline = math.nan
    if projection and number in (0, 2):
        other = numbers.get(_CAMERA_NUMBER.sub(lambda m: f"{number + 1:0{len(m[0])}d}", name), ())
        if len(other) == 12:
            shift = (numbers[name][3] - other[3]) / intrinsics[0]
            baseline = shift if shift > 0 else math.nan
    return CameraNumbers(
        intrinsics,
        f"KITTI-like lines, {name}",
        size_of(*size) if len(size) == 2 else None,
        baseline,
        lens,
    )


def _number_in(name: str) -> int | None:
    found = _CAMERA_NUMBER.search(name)
    return int(found[0]) if found else None
