"""Depth of a laser scanner's points, as the colour camera sees them; and where the scanner is.

Source: Hartley and Zisserman, Multiple View Geometry, 2nd ed., 6.1: a point R p + t in the camera's
frame falls on K (R p + t); and a unit quaternion's rotation, Diebel, Representing Attitude (2006),
equation 125.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.arrays import LEAST_DEPTH_M
from nimprep.camera import Camera
from nimprep.errors import CameraError, DecodeError
from nimprep.files import read_file
from nimprep.kitti.lidar import project_points, read_points
from nimprep.readers.camera_formats.numbers import number_of, numbers_in, numbers_of_text
from nimprep.readers.camera_formats.plain_text import keyed_lines, without_comments
from nimprep.readers.camera_formats.yaml_events import parse_yaml
from nimprep.readers.cameras import GivenCamera
from nimprep.readers.depth_units import PLAUSIBLE_MEDIAN_M
from nimprep.readers.description import DepthSource, TransformSource
from nimprep.readers.matching import Matched, Place, files_for
from nimprep.readers.undistortion import pixel_map
from nimprep.schema import parse_json

_MAX_BYTES = 1 << 18
_ROTATION_TOLERANCE = 1e-2

_FARTHEST_M = 10.0
"""A scanner further from the camera is one whose place is in millimetres, or a pose."""

Transform = npt.NDArray[np.float64]


class ScannerPlaces:
    """Give the transform from the scanner's frame to the camera's, (3, 4), of each frame.

    Parameters
    ----------
    root : Path
        The dataset's folder.
    source : DepthSource, optional
        Whose `to_camera` says it.
    matched : Matched
        The frames; `lacking` says of which there is no file.
    """

    def __init__(self, root: Path, source: DepthSource | None, matched: Matched) -> None:
        self._source = None if source is None else source.to_camera
        self.lacking: Mapping[str, str] = {}
        self._files: Mapping[str, Path] = {}
        if self._source is None:
            return
        places = files_for(root, self._source.files, matched.captured)
        self._files = {frame_id: place.path for frame_id, place in places.items()}
        self.lacking = {
            i: f"{root}: expected the scanner's place of frame {i!r} like {self._source.files!r}, "
            "found none"
            for i in matched.places.get("depth", {})
            if i not in self._files
        }

    def of(self, frame_id: str) -> Transform:
        """Return the transform of a frame.

        Raises
        ------
        CameraError
            Its file says none.
        """
        assert self._source is not None
        return transform_from_file(self._files[frame_id], self._source)

    def sources(self, frame_id: str) -> tuple[Path, ...]:
        """Return the files that say it."""
        return (self._files[frame_id],) if frame_id in self._files else ()


def depth_of_points(
    place: Place, source: DepthSource, to_camera: Transform, given: GivenCamera, camera: Camera
) -> npt.NDArray[np.float32]:
    """Return the depth of a scan's points in a pinhole's image; the nearest of a pixel wins.

    The pinhole's image is undistorted already, so that points fall into it without the lens: its
    polynomial, which holds in the image alone, would fold back what lies far outside.

    Parameters
    ----------
    to_camera : (3, 4) float64, metres
        From the scanner's frame to the camera's.
    given : GivenCamera
        With the lens that the image was taken through.
    camera : Camera
        Of the image as it is without.

    Returns
    -------
    (H, W) float32, metres
        Along the camera's axis; 0 = no point, and where the lens did not show anything.

    Raises
    ------
    DecodeError
        The scan is damaged, none of its points is in the image, or their unit is plainly another.
    """
    points = read_points(place.path, source.columns, "a laser scan")
    depth_m = project_points(
        points[:, :3] * source.scale, to_camera, camera.matrix, camera.height, camera.width
    )
    if given.distortion is not None:
        depth_m[~pixel_map(camera, given.distortion).inside] = 0
    seen = depth_m[depth_m >= LEAST_DEPTH_M]
    if seen.size == 0:
        raise DecodeError(
            f"{place.path}: expected points in the image, found none of {len(points)}; "
            "look whether 'invert' in the description's to_camera is right"
        )
    low, high = PLAUSIBLE_MEDIAN_M
    median = float(np.median(seen))
    if not low <= median <= high:
        raise DecodeError(
            f"{place.path}: expected a median depth of {low:g} to {high:g} m, found {median:g} m "
            f"at {source.scale:g} m per unit; mend the description's depth"
        )
    return depth_m


def transform_from_file(path: Path, source: TransformSource) -> Transform:
    """Read a rigid transform, (3, 4), metres, of a YAML, JSON or text file.

    An object has a quaternion (q or rotation: w, x, y, z) and a shift (t or translation: x, y, z),
    or a matrix of 12 or 16 numbers by rows; text has these numbers alone, or a line of a name
    and them, as KITTI's calib.txt has ``Tr:``.

    Raises
    ------
    CameraError
        It cannot be read, says none, or several of which `key` names none.
    """
    data = read_file(path, _MAX_BYTES, "a readable transform", CameraError)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CameraError(
            f"{path}: expected a transform in text, found binary data; give it in YAML"
        ) from error
    value = _chosen(_parsed(text, path), source.key, path)
    numbers = numbers_in(value) if isinstance(value, (list, Mapping)) else value
    if isinstance(value, Mapping) and not numbers:
        matrix = _of_parts(value, path)
    elif isinstance(numbers, tuple) and len(numbers) in (12, 16):
        matrix = np.array(numbers[:12], np.float64).reshape(3, 4)
    else:
        raise _none(path, "no 12 or 16 numbers, and no q and t")
    r, shift = matrix[:, :3], matrix[:, 3]
    if not np.abs(r @ r.T - np.eye(3)).max() <= _ROTATION_TOLERANCE or np.linalg.det(r) < 0:
        raise _none(path, f"the rotation {np.round(r, 4).tolist()}")
    if not np.linalg.norm(shift) <= _FARTHEST_M:
        raise CameraError(
            f"{path}: expected a shift of at most {_FARTHEST_M:g} m, found "
            f"{np.linalg.norm(shift):g} m; give it in metres, between scanner and camera"
        )
    if not source.invert:
        return matrix
    return np.concatenate([r.T, -(r.T @ shift)[:, None]], axis=1)


def _none(path: Path, found: str) -> CameraError:
    return CameraError(
        f"{path}: expected a rotation and a shift (q and t, or a matrix by rows), found {found}; "
        "name which is meant as 'key' in the description's to_camera"
    )


def _parsed(text: str, path: Path) -> Any:
    """Return what a file holds: an object, or the numbers of a text, by names where it has some."""
    if path.suffix.lower() == ".json" or text.lstrip()[:1] == "{":
        try:
            return parse_json(text.encode())
        except ValueError as error:
            raise CameraError(
                f"{path}: expected a transform in JSON, found {error}; mend it"
            ) from error
    if path.suffix.lower() in (".yaml", ".yml"):
        return parse_yaml(text, str(path))
    plain = without_comments(text)
    numbers = numbers_of_text(plain)
    if numbers is not None:
        return numbers
    return {name: numbers_of_text(words) for name, words in keyed_lines(plain).items()}


def _chosen(document: Any, key: str | None, path: Path) -> Any:
    """Return what stands under the key; without one, the only entry of a file of one."""
    if not isinstance(document, Mapping):
        return document
    if key is not None:
        if key not in document:
            known = ", ".join(map(str, list(document)[:8])) or "nothing"
            raise CameraError(
                f"{path}: expected the transform {key!r}, found {known}; check the file"
            )
        return document[key]
    values = list(document.values())
    one = len(values) == 1 and isinstance(values[0], (Mapping, list, tuple))
    return values[0] if one else document


def _of_parts(value: Mapping[str, Any], path: Path) -> Transform:
    """Return the matrix of a quaternion and a translation."""
    q = _numbers(value.get("q", value.get("rotation")), "wxyz")
    t = _numbers(value.get("t", value.get("translation")), "xyz")
    if q is None or t is None:
        raise _none(path, f"{', '.join(map(str, list(value)[:8]))}")
    length = float(np.linalg.norm(q))
    if not abs(length - 1) <= _ROTATION_TOLERANCE:
        raise _none(path, f"a quaternion of length {length:g}")
    w, x, y, z = (float(part) / length for part in q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), t[0]],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), t[1]],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), t[2]],
        ]
    )


def _numbers(value: Any, names: str) -> list[float] | None:
    """Return the numbers of these names; None = one is none."""
    if not isinstance(value, Mapping):
        return None
    found = [number_of(value.get(name)) for name in names]
    return None if any(number != number for number in found) else found
