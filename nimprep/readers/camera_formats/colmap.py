"""COLMAP's cameras.txt: a line per camera, ``id MODEL width height parameters``.

Models and the order of their parameters as in COLMAP's documentation (colmap.github.io/cameras).
Its pixels have their centres at halves: (0.5, 0.5) is that of the top-left pixel.
"""

from __future__ import annotations

import re

from nimprep.errors import CameraError
from nimprep.readers.camera_formats.numbers import CameraNumbers, number_of, size_of
from nimprep.readers.description import CameraSource
from nimprep.readers.distortion import Distortion, distortion_from

_LINE = re.compile(r"\s*\d+\s+[A-Z][A-Z_]+\s+\d+\s+\d+(\s|$)")
_MODELS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
}


def is_colmap(text: str) -> bool:
    """Return whether the first line that is no comment is a camera of COLMAP's."""
    first = next((s for s in text.splitlines() if s.strip() and s.lstrip()[0] != "#"), "")
    return _LINE.match(first) is not None


def numbers_of_colmap(text: str, where: str, source: CameraSource) -> CameraNumbers:
    """Return the camera of a cameras.txt; `source.key` is its id, where there are several.

    Raises
    ------
    CameraError
        A line is no camera, of another model than those known here, or there are several cameras.
    """
    lines = [s.split() for s in text.splitlines() if s.strip() and s.lstrip()[0] != "#"]
    if source.key is not None:
        ids = [words[0] for words in lines]
        lines = [words for words in lines if words[0] == source.key]
        if not lines:
            raise CameraError(
                f"{where}: expected a camera with the id {source.key}, found "
                f"{', '.join(ids[:8])[:80]}; name one of these by camera.key"
            )
    found = {_camera(words, where) for words in lines}
    if len(found) != 1:
        raise CameraError(
            f"{where}: expected one camera, found {len(found)}; name one by its id with the "
            "description's camera.key"
        )
    return found.pop()


def _camera(words: list[str], where: str) -> CameraNumbers:
    model = words[1][:80] if len(words) > 1 else ""
    if model not in _MODELS:
        raise CameraError(
            f"{where}: expected a camera of a model of {', '.join(_MODELS)}, found {model!r}; "
            "undistort the images with COLMAP's image_undistorter"
        )
    names = _MODELS[model].split()
    values = [number_of(word) for word in words[4:]]
    size = size_of(*words[2:4]) if len(words) > 3 else None
    if len(values) != len(names) or any(v != v for v in values) or size is None:
        raise CameraError(
            f"{where}: expected width, height and {' '.join(names)} for {model}, found "
            f"{' '.join(words[2:])[:100]!r}; export cameras.txt anew"
        )
    given = dict(zip(names, values, strict=True))
    fx, fy = given.get("fx", given.get("f", 0)), given.get("fy", given.get("f", 0))
    return CameraNumbers(
        (fx, fy, given["cx"] - 0.5, given["cy"] - 0.5),
        "COLMAP cameras",
        size,
        distortion=_lens(model, given),
    )


def _lens(model: str, given: dict[str, float]) -> Distortion | None:
    order = ["k1", "k2", "k3", "k4"] if "FISHEYE" in model else ["k1", "k2", "p1", "p2"]
    if model == "FULL_OPENCV":
        order += ["k3", "k4", "k5", "k6"]
    return distortion_from(model, [given.get(name, 0.0) for name in order])
