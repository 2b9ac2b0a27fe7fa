"""Dense depth of a KITTI road frame, from whichever origin is there."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from nimprep.doubts.raw import check_byte_order, raw_signs
from nimprep.errors import DecodeError, DepthLossWarning, LayoutError
from nimprep.files import check_file, write_whole
from nimprep.folders import refuse_inside
from nimprep.images import read_depth, read_header, read_rgb
from nimprep.kitti.calibration import FRAME_SHAPES, Calibration, read_calibration
from nimprep.kitti.images import png_bytes
from nimprep.kitti.layout import RoadFiles, list_road_files
from nimprep.kitti.lidar import project_lidar, read_velodyne
from nimprep.kitti.names import DepthFrom
from nimprep.kitti.stereo import stereo_depth
from nimprep.parallel import Progress, map_frames

DepthOrigin = Literal["depth_u16", "lidar", "stereo"]

SATURATED_MM = 65535
"""Millimetres too many for 16 bits are written as this, and it is read as no depth."""

RECORD = "depth.json"

_ORDER: tuple[DepthOrigin, ...] = ("depth_u16", "lidar", "stereo")


def whole_millimetres(depth_m: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return depth in metres as it is to a millimetre, however far.

    What rounds to `SATURATED_MM` becomes a millimetre more: an image of 16 bits has neither, and so
    what a store in millimetres has does not depend on how the depth came to it.
    """
    with np.errstate(over="ignore"):
        thousandths: npt.NDArray[np.float32] = np.rint(depth_m * np.float32(1000))
    thousandths[thousandths == SATURATED_MM] += 1
    return thousandths / np.float32(1000)


def millimetres_from_metres(depth_m: npt.NDArray[np.float32]) -> npt.NDArray[np.uint16]:
    """Return depth as a depth_u16 image holds it: 0 = none, 65535 = 65.535 m or more."""
    with np.errstate(over="ignore"):
        thousandths: npt.NDArray[np.float32] = np.rint(depth_m * np.float32(1000))
    return np.clip(thousandths, 0, SATURATED_MM).astype(np.uint16)


def metres_from_millimetres(depth_mm: npt.NDArray[np.uint16]) -> npt.NDArray[np.float32]:
    """Return a depth_u16 image as float32 metres; 0 and 65535 become 0 = none."""
    depth_m = np.divide(depth_mm, np.float32(1000), dtype=np.float32)
    depth_m[depth_mm == SATURATED_MM] = 0
    return depth_m


def origin_file(files: RoadFiles, origin: DepthOrigin) -> Path:
    """Return the file that makes an origin available for a frame."""
    return {"depth_u16": files.depth, "lidar": files.scan, "stereo": files.right_image}[origin]


def choose_origin(
    files: RoadFiles, wanted: DepthFrom = "auto", sparse: bool = False
) -> DepthOrigin:
    """Return the depth origin to use for a frame: depth_u16, else LiDAR, else stereo.

    `sparse` leaves depth_u16 out, which is dense.

    Raises
    ------
    LayoutError
        None of what was looked for is there.
    """
    choices = [s for s in _ORDER if wanted in ("auto", s) and not (sparse and s == "depth_u16")]
    for origin in choices:
        if origin_file(files, origin).is_file():
            return origin
    places = " or ".join(str(origin_file(files, s).relative_to(files.folder)) for s in choices)
    raise LayoutError(
        f"{files.folder}: expected {places} to make depth of frame {files.id}, found none"
        + ("; --from auto takes what each frame has" if wanted != "auto" else "")
    )


def check_frame_size(shape: tuple[int, int], calibration: Calibration, image: Path) -> None:
    """Raise `DecodeError` where P2 is known to belong to images of another size."""
    expected = FRAME_SHAPES.get(round(float(calibration.matrix("P2")[0, 0]), 4), shape)
    if expected != shape:
        raise DecodeError(
            f"{image}: expected {expected[1]}x{expected[0]} pixels for P2 of {calibration.path}, "
            f"found {shape[1]}x{shape[0]}"
        )


def frame_depth(
    files: RoadFiles, origin: DepthOrigin, sparse: bool = False, *, far: bool = False
) -> npt.NDArray[np.float32]:
    """Return a frame's depth, as a depth_u16 image of it would be read.

    LiDAR and stereo are interpolated linearly, inside the convex hull of what was measured, and
    rounded to millimetres.

    Parameters
    ----------
    files : RoadFiles
    origin : {"depth_u16", "lidar", "stereo"}
    sparse : bool
        Leave LiDAR and stereo as measured.
    far : bool
        Keep what LiDAR and stereo have beyond what such an image holds.

    Returns
    -------
    (H, W) float32, metres
        0 = none, and where a depth_u16 image says 65.535 m or more, or would.

    Raises
    ------
    DecodeError
        A file is bad, or sizes differ.
    """
    depth = _measured_depth(files, origin, sparse)
    if far and depth.dtype != np.uint16:
        return whole_millimetres(depth)
    return metres_from_millimetres(_millimetres(depth))


def frame_depth_mm(
    files: RoadFiles, origin: DepthOrigin, sparse: bool = False
) -> npt.NDArray[np.uint16]:
    """Return a frame's depth as `frame_depth` does, in millimetres; 65535 = saturated."""
    return _millimetres(_measured_depth(files, origin, sparse))


def _millimetres(depth: npt.NDArray[Any]) -> npt.NDArray[np.uint16]:
    return depth if depth.dtype == np.uint16 else millimetres_from_metres(depth)


def _measured_depth(files: RoadFiles, origin: DepthOrigin, sparse: bool) -> npt.NDArray[Any]:
    """Return a depth_u16 image as it is, or else metres of LiDAR or stereo."""
    calibration = read_calibration(files.calibration)
    header = read_header(files.image)
    shape = (header.height, header.width)
    check_frame_size(shape, calibration, files.image)
    measure: dict[DepthOrigin, Callable[[], npt.NDArray[Any]]] = {
        "depth_u16": lambda: _stored_depth(files),
        "lidar": lambda: project_lidar(read_velodyne(files.scan), calibration, *shape),
        "stereo": lambda: _stereo_of_frame(files, calibration),
    }
    depth = measure[origin]()
    if depth.shape != shape:
        raise DecodeError(
            f"{origin_file(files, origin)}: expected {shape[1]}x{shape[0]} pixels like "
            f"{files.image}, found {depth.shape[1]}x{depth.shape[0]}"
        )
    if depth.dtype == np.uint16:
        return depth
    if not depth.any():
        raise DecodeError(
            f"{origin_file(files, origin)}: expected depth somewhere in the image, found none"
        )
    if not sparse:
        from nimprep.derive.completion import fill_depth

        depth, _ = fill_depth(depth, method="linear", num_threads=1)
    return depth


def _stored_depth(files: RoadFiles) -> npt.NDArray[Any]:
    depth = read_depth(files.depth)
    if depth.dtype != np.uint16:
        raise DecodeError(f"{files.depth}: expected 16-bit millimetres, found {depth.dtype}")
    if not ((depth > 0) & (depth < SATURATED_MM)).any():
        raise DecodeError(f"{files.depth}: expected depth, found no pixel that has any")
    check_byte_order(raw_signs(depth), files.depth)
    return depth


def _stereo_of_frame(files: RoadFiles, calibration: Calibration) -> npt.NDArray[np.float32]:
    left, right = read_rgb(files.image), read_rgb(files.right_image)
    if left.shape != right.shape:
        raise DecodeError(
            f"{files.right_image}: expected {left.shape[1]}x{left.shape[0]} pixels like "
            f"{files.image}, found {right.shape[1]}x{right.shape[0]}"
        )
    return stereo_depth(left, right, calibration)


class _Saturated(NamedTuple):
    """Say how much of an image's depth is too far for it: pixels, of how many, and the farthest."""

    pixels: int
    known: int
    farthest_m: float


def _saturated(depth: npt.NDArray[Any], image: npt.NDArray[np.uint16]) -> _Saturated:
    known = int(np.count_nonzero(image))
    if depth.dtype == np.uint16:  # An image that was there, and stays what it is.
        return _Saturated(0, known, 0.0)
    far = depth[image == SATURATED_MM]
    return _Saturated(far.size, known, float(far.max(initial=0)))


def _warn_of_saturated(src: Path, frames: Iterable[_Saturated]) -> None:
    found = list(frames)
    pixels = sum(frame.pixels for frame in found)
    if pixels == 0:
        return
    share = 100 * pixels / sum(frame.known for frame in found)
    number = sum(frame.pixels > 0 for frame in found)
    warnings.warn(
        f"{src}: {f'{share:.2g}' if share >= 0.01 else 'less than 0.01'} % of the depth, in "
        f"{number} frame{'' if number == 1 else 's'}, is {SATURATED_MM} in the images, which is "
        f"read as none: it lies at {SATURATED_MM / 1000} m or beyond, the farthest at "
        f"{max(frame.farthest_m for frame in found):.6g} m; nimprep convert --depth-unit cm keeps "
        "it in a store",
        DepthLossWarning,
        stacklevel=3,
    )


def write_depth(
    src: Path | str,
    out: Path | str,
    wanted: DepthFrom = "auto",
    sparse: bool = False,
    progress: Progress | None = None,
    *,
    overwrite: bool = False,
) -> dict[str, DepthOrigin]:
    """Write the depth of every frame of a road folder as ``OUT/training/depth_u16/<name>.png``.

    16-bit millimetres: 0 = none, 65535 = 65.535 m or more; how much of LiDAR and stereo is that is
    said by a `nimprep.errors.DepthLossWarning`. ``OUT/depth.json`` records the origin of each frame
    (schemas/kitti-depth.schema.json).

    Parameters
    ----------
    src : folder
        ``data_road``; never written to.
    out : folder
        Made as needed.
    wanted : {"auto", "lidar", "stereo"}
        auto: depth_u16 where it is there, else LiDAR, else stereo.
    sparse : bool
        Leave LiDAR and stereo as measured.
    overwrite : bool
        Replace images that are there already; without, they are an error.

    Returns
    -------
    dict of frame id to origin

    Raises
    ------
    LayoutError
        No frames, a frame without an origin, `out` inside `src`, or a file there already.
    DecodeError
        A file is bad.
    """
    src, out = Path(src), Path(out)
    refuse_inside(out, src)
    chosen = {files: choose_origin(files, wanted, sparse) for files in list_road_files(src)}
    images = {f: out / f.split / "depth_u16" / f"{f.name}.png" for f in chosen}
    for path in (out / RECORD, *images.values()):
        check_file(path, src, overwrite=overwrite)

    def write(item: tuple[RoadFiles, DepthOrigin]) -> _Saturated:
        files, origin = item
        depth = _measured_depth(files, origin, sparse)
        image = _millimetres(depth)
        write_whole(images[files], png_bytes(image), src, overwrite=overwrite)
        return _saturated(depth, image)

    _warn_of_saturated(src, map_frames("depth", write, list(chosen.items()), progress))
    record = {
        "format": "nimprep-kitti-depth",
        "version": "1.0",
        "sparse": sparse,
        "frames": {files.id: origin for files, origin in chosen.items()},
    }
    text = json.dumps(record, indent=2) + "\n"
    write_whole(out / RECORD, text.encode(), src, overwrite=overwrite)
    return {files.id: origin for files, origin in chosen.items()}
