"""Frames as one Rerun recording (.rrd): camera, point cloud, images and labels over time::

/                 x right, y down, z forward; the classes' names and colours
/camera           pinhole camera
/camera/rgb       PNG
/camera/depth     16 bits, in the store's unit, which Rerun is told
/camera/normal    PNG in the usual colours
/camera/hha       PNG
/camera/label     class ids
/camera/thermal   and other planes of the dataset's own: float32 in their units, NaN = none
/points           points in the camera frame, metres, with colour and class
/frame            id, split, group

The timeline "frame" counts frames as the store does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.errors import NimprepError
from nimprep.frame import IGNORE_LABEL
from nimprep.kitti.images import png_bytes
from nimprep.parallel import Progress, map_frames
from nimprep.report.pictures import normal_picture
from nimprep.splits import SPLIT_NAMES
from nimprep.store.reader import Store

MAX_POINTS = 200_000
"""Points of a frame are taken from every n-th row and column, so that there are at most so many."""

PATIENCE_S = 60.0
"""Waiting longer for a frame to reach the file means that it never will."""

_ROOM = 1 << 16
"""Bytes that must fit before a recording is begun: Rerun hangs where not even its first do."""

_FOOTER = b"RRF2FOOT"
"""Ends a recording that was written to its end."""


class MissingRerunError(NimprepError, ImportError):
    """A recording was asked for without the library that writes it."""


@dataclass(frozen=True)
class PointCloud:
    """Hold points in the camera frame.

    Attributes
    ----------
    positions : (N, 3) float32, metres
    colors : (N, 3) uint8, R, G, B, or None
    class_ids : (N,) uint8, or None
    """

    positions: npt.NDArray[np.float32]
    colors: npt.NDArray[np.uint8] | None
    class_ids: npt.NDArray[np.uint8] | None


def check_library() -> None:
    """Raise `MissingRerunError` where the extra `rerun` is not installed."""
    if find_spec("rerun") is None:
        raise MissingRerunError(
            "export: expected rerun-sdk for --format rerun, found none; "
            "pip install 'nimprep[rerun]'"
        )


def point_cloud(
    depth_m: npt.NDArray[np.float32],
    camera: Camera,
    rgb: npt.NDArray[np.uint8] | None = None,
    label: npt.NDArray[np.uint8] | None = None,
    limit: int = MAX_POINTS,
) -> PointCloud:
    """Return the pixels with depth as points, at most `limit`, evenly spread over the image."""
    step = max(1, math.ceil(math.sqrt(depth_m.size / limit)))
    taken = np.s_[::step, ::step]
    z = depth_m[taken]
    v, u = np.nonzero(z > 0)
    z = z[v, u]
    x = (u * step - camera.cx) * z / camera.fx
    y = (v * step - camera.cy) * z / camera.fy
    return PointCloud(
        np.stack([x, y, z], axis=1).astype(np.float32),
        None if rgb is None else rgb[taken][v, u],
        None if label is None else label[taken][v, u],
    )


def write_recording(
    store: Store, numbers: Sequence[int], path: Path, progress: Progress | None
) -> None:
    """Write the frames as one recording, in order.

    Raises
    ------
    MissingRerunError
        rerun-sdk is not installed.
    OSError
        The recording cannot be written.
    """
    check_library()
    import rerun as rr

    path.write_bytes(bytes(_ROOM))
    recording = rr.RecordingStream("nimprep")
    recording.save(path)
    try:
        recording.log("/", rr.ViewCoordinates.RDF, static=True)
        if store.classes:
            recording.log("/", rr.AnnotationContext(_annotations(store)), static=True)
        logged = map_frames("export", lambda number: _entries(store, number), numbers, progress)
        for number, entries in zip(numbers, logged, strict=True):
            recording.set_time("frame", sequence=number)
            for entity, values in entries.items():
                recording.log(entity, values)
            recording.flush(timeout_sec=PATIENCE_S)
    except (RuntimeError, TimeoutError) as error:
        raise OSError(str(error)) from error
    finally:
        recording.disconnect()
    # The last of it is written behind our back, and a full disk then is no error.
    with path.open("rb") as file:
        file.seek(-min(64, path.stat().st_size), 2)
        if _FOOTER not in file.read():
            raise OSError("it cut short")


def _annotations(store: Store) -> list[tuple[int, str, tuple[int, int, int]]]:
    classes = [(c.id, c.name, c.color) for c in store.classes]
    return [*classes, (IGNORE_LABEL, "ignore", (40, 40, 40))]


def _entries(store: Store, index: int) -> dict[str, Any]:
    """Return what is logged of a frame, by entity."""
    import rerun as rr

    frame, camera = store[index], store.camera(index)
    pictures = {
        "rgb": frame.rgb,
        "normal": None if frame.normal is None else normal_picture(frame.normal),
        "hha": frame.hha,
    }
    entries: dict[str, Any] = {
        "frame": rr.AnyValues(
            id=frame.id,
            split=SPLIT_NAMES.get(int(store.tables.split[index]), "none"),
            group=frame.group,
        ),
        "camera": rr.Pinhole(
            image_from_camera=camera.matrix,
            resolution=[camera.width, camera.height],
            camera_xyz=rr.ViewCoordinates.RDF,
        ),
    }
    for name, picture in pictures.items():
        if picture is not None:
            png = rr.EncodedImage(contents=png_bytes(picture), media_type="image/png")
            entries[f"camera/{name}"] = png
    if frame.label is not None:
        entries["camera/label"] = rr.SegmentationImage(frame.label)
    for plane in store.planes:
        entries[f"camera/{plane.name}"] = rr.Image(frame[plane.name], color_model="L")
    if frame.depth_m is not None:
        height, width = camera.shape
        stored = np.ascontiguousarray(store.arrays["depth"].read(index)[:height, :width])
        meter = float(store.modality("depth").steps)
        entries["camera/depth"] = rr.DepthImage(stored, meter=meter)
        cloud = point_cloud(frame.depth_m, camera, frame.rgb, frame.label)
        entries["points"] = rr.Points3D(
            cloud.positions, colors=cloud.colors, class_ids=cloud.class_ids
        )
    return entries
