"""A KITTI calibration file, and the transforms and cameras that follow from it.

Frames, in the order in which the file's matrices chain them: `velo`, the laser scanner (x forward,
y left, z up); `cam0`, the left grey camera before rectification; `rect`, cam0 rectified; `cam`, the
left colour camera (image_2), rectified. `road` is x right, y down from the road's surface, z
forward. Transforms are named by their frames: `cam_to_road`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nimprep.arrays import without_mask
from nimprep.camera import MAX_BASELINE_M, Camera
from nimprep.errors import CameraError, DecodeError
from nimprep.files import read_file
from nimprep.folders import place_of
from nimprep.kitti.layout import image_of

Matrix = npt.NDArray[np.float64]

FRAME_SHAPES = {
    721.5377: (375, 1242),
    718.856: (376, 1241),
    707.0912: (370, 1226),
    707.0493: (370, 1224),
}
"""(height, width) of a KITTI road image by its calibration's P2 focal length, pixels: read off the
benchmark's test images and calibrations."""

_SHAPES = {
    "P2": (3, 4),
    "P3": (3, 4),
    "R0_rect": (3, 3),
    "Tr_velo_to_cam": (3, 4),
    "Tr_cam_to_road": (3, 4),
}
_ALIASES = {"R_rect": "R0_rect", "Tr_velo_cam": "Tr_velo_to_cam"}
_MAX_BYTES = 1 << 16
_QUOTED = 200
_LARGEST = 1e9
_SHORTEST_FOCAL = 1e-3
_ROTATION_TOLERANCE = 1e-2


def _homogeneous(matrix: Matrix) -> Matrix:
    full = np.eye(4)
    full[: matrix.shape[0], : matrix.shape[1]] = matrix
    return full


@dataclass(frozen=True)
class Calibration:
    """Hold one frame's calibration; what it lacks is an error when it is asked for.

    Attributes
    ----------
    path : Path
        The file, for messages.
    matrices : mapping of str to float64 array
        As in the file: P2 and P3 (3, 4), pixels; R0_rect (3, 3); Tr_velo_to_cam and
        Tr_cam_to_road (3, 4), metres.
    """

    path: Path
    matrices: Mapping[str, Matrix]

    def matrix(self, name: str) -> Matrix:
        """Return one of the file's matrices.

        Raises
        ------
        DecodeError
            The file lacks it.
        ArrayError
            It does not come from a file, and a part is masked.
        """
        if name not in self.matrices:
            found = ", ".join(self.matrices) or "none"
            raise DecodeError(f"{self.path}: expected the matrix {name}, found only {found}")
        return np.asarray(without_mask(self.matrices[name], name), dtype=np.float64)

    @property
    def intrinsics(self) -> Matrix:
        """K of the image_2 camera, (3, 3), pixels."""
        return self.matrix("P2")[:, :3]

    def camera(self, height: int, width: int) -> Camera:
        """Return the image_2 camera at this image size.

        Raises
        ------
        CameraError
            P2's numbers make no camera.
        """
        try:
            return Camera.from_matrix(self.intrinsics, width, height)
        except CameraError as error:
            raise CameraError(f"{self.path}: {error}") from error

    @property
    def rect_to_cam(self) -> Matrix:
        """(4, 4), metres: P2 = K (I | t), so the image_2 camera sees rect's points moved by t."""
        return self._shift("P2")

    def _shift(self, name: str) -> Matrix:
        p = self.matrix(name)
        shift = np.eye(4)
        shift[:3, 3] = np.linalg.solve(p[:, :3], p[:, 3])
        return shift

    @property
    def baseline_m(self) -> float:
        """Distance from the image_2 to the image_3 camera along x, metres.

        Raises
        ------
        DecodeError
            The file lacks a matrix, or image_3's camera is not to the right.
        """
        baseline_m = float(self._shift("P2")[0, 3] - self._shift("P3")[0, 3])
        if not 0 < baseline_m <= MAX_BASELINE_M:
            raise DecodeError(
                f"{self.path}: expected P3's camera to the right of P2's, "
                f"at most {MAX_BASELINE_M:g} m, found a baseline of {baseline_m:g} m"
            )
        return baseline_m

    @property
    def has_road(self) -> bool:
        """Whether the file says where the road is."""
        return "Tr_cam_to_road" in self.matrices

    @property
    def cam_to_road(self) -> Matrix:
        """(3, 4), metres: from the image_2 camera to the road frame.

        Tr_cam_to_road starts at cam0, so rectification and P2's shift are undone first.
        """
        cam_to_cam0 = np.linalg.inv(self.rect_to_cam @ _homogeneous(self.matrix("R0_rect")))
        return self.matrix("Tr_cam_to_road") @ cam_to_cam0

    @property
    def velo_to_cam(self) -> Matrix:
        """(3, 4), metres: from the laser scanner to the image_2 camera."""
        cam0_to_cam = self.rect_to_cam @ _homogeneous(self.matrix("R0_rect"))
        return (cam0_to_cam @ _homogeneous(self.matrix("Tr_velo_to_cam")))[:3]

    @property
    def road_to_image(self) -> Matrix:
        """(3, 3): from (x, z, 1) on the road's plane y = 0, metres, to image_2, pixels times w."""
        road_to_cam0 = np.linalg.inv(_homogeneous(self.matrix("Tr_cam_to_road")))
        projection = self.matrix("P2") @ _homogeneous(self.matrix("R0_rect")) @ road_to_cam0
        return projection[:, [0, 2, 3]]


def read_calibration(path: Path | str) -> Calibration:
    """Read a calibration file of the road or the object benchmark.

    Raises
    ------
    DecodeError
        It cannot be read; a matrix that is used here has another count of numbers, one that is
        not finite, or is no camera or rotation.
    """
    path = Path(path)
    data = read_file(path, _MAX_BYTES, "a calibration file")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise DecodeError(f"{path}: expected a calibration in text, found binary data") from error
    matrices: dict[str, Matrix] = {}
    for line in text.splitlines():
        key, separator, numbers = line.partition(":")
        name = _ALIASES.get(key.strip(), key.strip())
        if separator and name in _SHAPES:
            matrices[name] = _parse_matrix(name, numbers, path)
    return Calibration(path, matrices)


def _parse_matrix(name: str, numbers: str, path: Path) -> Matrix:
    shape = _SHAPES[name]
    count = shape[0] * shape[1]
    try:
        values = [float(number) for number in numbers.split()]
    except ValueError as error:
        found = " ".join(str(error).split())[:_QUOTED]
        raise DecodeError(f"{path}: expected {count} numbers for {name}, found {found}") from error
    if len(values) != count:
        raise DecodeError(f"{path}: expected {count} numbers for {name}, found {len(values)}")
    matrix = np.array(values, dtype=np.float64).reshape(shape)
    if not np.abs(matrix).max() <= _LARGEST:
        raise DecodeError(
            f"{path}: expected finite numbers for {name}, found {numbers.strip()[:_QUOTED]}"
        )
    (_check_projection if name.startswith("P") else _check_rotation)(name, matrix, path)
    return matrix


def _check_projection(name: str, p: Matrix, path: Path) -> None:
    k = p[:, :3]
    too_short = min(k[0, 0], k[1, 1]) < _SHORTEST_FOCAL
    if too_short or k[0, 1] != 0 or k[1, 0] != 0 or tuple(k[2]) != (0, 0, 1):
        raise DecodeError(
            f"{path}: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in {name}, found {k.tolist()}"
        )


def _check_rotation(name: str, matrix: Matrix, path: Path) -> None:
    r = matrix[:, :3]
    off = float(np.abs(r @ r.T - np.eye(3)).max())
    if not off <= _ROTATION_TOLERANCE or np.linalg.det(r) < 0:
        raise DecodeError(f"{path}: expected a rotation in {name}, found {r.tolist()}")


def frame_shape(calibration: Calibration) -> tuple[int, int] | None:
    """Return (height, width) of the frame a calibration belongs to.

    From the image_2 folder beside the calibration's where the image is there, else by P2's focal
    length from `FRAME_SHAPES`; None where neither says.

    Raises
    ------
    DecodeError
        The image is there but is none.
    """
    from nimprep.images import read_header

    folder = place_of(calibration.path.parent).parent
    image = image_of(folder / "image_2", calibration.path.stem)
    if image.is_file():
        header = read_header(image)
        return header.height, header.width
    return FRAME_SHAPES.get(round(float(calibration.matrix("P2")[0, 0]), 4))
