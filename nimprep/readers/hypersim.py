"""Hypersim: rendered rooms, with the split and the cameras of its tables where they are there.

Without metadata_camera_parameters.csv all scenes have the camera that most have, 60 degrees wide.
Some scenes tilt or shift the lens: then the table's projection says where rays go. A tilted image
plane is that of a camera that looks along its normal: depth is counted along that, since poses play
no part here.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import LayoutError, NimprepError
from nimprep.files import read_file
from nimprep.images import read_header
from nimprep.readers.description import CameraSource, Description, SplitSource
from nimprep.readers.folder import FolderReader
from nimprep.readers.split_lists import CALLED
from nimprep.splits import SplitName

SPLIT = "metadata_images_split_scene_v1.csv"
CAMERAS = "metadata_camera_parameters.csv"

_MAX_BYTES = 1 << 28
_BESIDE = (".", "analysis", "..", "../analysis", "../evermotion_dataset/analysis")
_MOST_SKEW_PX = 0.5
"""By so much a row of pixels may be moved against another, over the whole image."""


def open_hypersim(
    root: Path,
    description: Description,
    *,
    lists: Path | str | None = None,
    **keywords: Any,
) -> FolderReader:
    """Open Hypersim's scenes.

    Parameters
    ----------
    lists : path, optional
        The table of the split, or the folder that the tables are in; None = in the folder of the
        scenes or beside it.

    Others are those of `FolderReader`.

    Raises
    ------
    LayoutError
        A table is not where it is said to be, or none.
    """
    described = _with_split(root, description, lists)
    if keywords.get("camera") is None:
        described = _with_cameras(root, described, lists)
    return FolderReader(root, described, **keywords)


def _found(root: Path, name: str, lists: Path | str | None) -> Path | None:
    """Return where a table is: in the folder that is given, or else in the usual places."""
    folders = [root / each for each in _BESIDE]
    if lists is not None:
        given = Path(lists)
        folders.insert(0, given if given.is_dir() else given.parent)
    return next((f / name for f in folders if (f / name).is_file()), None)


def _rows(path: Path, columns: tuple[str, ...]) -> Iterator[dict[str, str]]:
    data = read_file(path, _MAX_BYTES, "a readable table", LayoutError)
    table = csv.DictReader(io.StringIO(data.decode("utf-8-sig", "replace")))
    lost = [name for name in columns if name not in (table.fieldnames or ())]
    if lost:
        raise LayoutError(
            f"{path}: expected a table with the columns {', '.join(columns)}, found no {lost[0]}; "
            "give the file as it was published"
        )
    yield from table


def _with_split(root: Path, description: Description, lists: Path | str | None) -> Description:
    """Return the description with the authors' split; or free, and that is said."""
    path = Path(lists) if lists is not None and not Path(lists).is_dir() else None
    path = path or _found(root, SPLIT, lists)
    if path is None and lists is not None:
        raise LayoutError(
            f"{lists}: expected the official split {SPLIT}, found none; leave out --lists to split "
            "anew"
        )
    if path is None:
        note = (
            f"the official split is not known, as {SPLIT} is neither in nor beside the folder: "
            "frames are split anew; --lists says where it is"
        )
        return replace(description, no_split=True, notes=(*description.notes, note))
    found: dict[str, SplitName] = {}
    columns = ("scene_name", "camera_name", "frame_id", "split_partition_name")
    for row in _rows(path, columns):
        scene, camera, frame, called = (row[name] or "" for name in columns)
        # Frames that were not published are in no split.
        if not called:
            continue
        if called not in CALLED or not frame.isdecimal():
            raise LayoutError(
                f"{path}: expected train, val or test of a frame's number, found {called[:40]!r} "
                f"of {frame[:40]!r}; give the file as it was published"
            )
        found[f"{scene}/{camera}/{int(frame):04d}"] = CALLED[called]
    return replace(description, split=SplitSource(frames=found))


def _with_cameras(root: Path, description: Description, lists: Path | str | None) -> Description:
    """Return the description with each scene's camera; or the usual one, and that is said."""
    path = _found(root, CAMERAS, lists)
    if path is None:
        note = (
            f"the scenes' cameras are not known, as {CAMERAS} is neither in nor beside the folder: "
            "60 degrees wide is assumed of all, as most are; some have a lens that is tilted"
        )
        return replace(description, notes=(*description.notes, note))
    names = [[f"M_proj_{row}{column}" for column in range(4)] for row in range(4)]
    columns = ("scene_name", *(name for row in names for name in row))
    cameras: dict[str, Mapping[str, Any] | str] = {}
    for row in _rows(path, columns):
        scene = row["scene_name"]
        if not (root / scene).is_dir() or not scene:
            continue
        try:
            projection = np.array([[float(row[name]) for name in line] for line in names])
        except (TypeError, ValueError):
            projection = np.full((4, 4), np.nan)
        size = _size(root, scene)
        if size is not None:
            cameras[scene] = camera_of_projection(projection, *size)
    source = CameraSource(by="scene", table=cameras, table_file=path)
    return replace(description, camera=source)


def _size(root: Path, scene: str) -> tuple[int, int] | None:
    """Return (height, width) of a scene's images, by the first that can be read."""
    for path in sorted((root / scene).glob("images/scene_cam_*_final_preview/*.tonemap.*"))[:8]:
        try:
            header = read_header(path)
        except NimprepError:
            # Reading the frame says so.
            continue
        return header.height, header.width
    return None


def camera_of_projection(
    projection: npt.NDArray[np.float64], height: int, width: int
) -> dict[str, Any] | str:
    """Return the pinhole camera, as JSON has it, of an OpenGL projection; or why there is none.

    Parameters
    ----------
    projection : (4, 4)
        Of points x right, y up, z backward to clip space, whose edges are those of the image.

    Notes
    -----
    Its rows x, y and w are a matrix M that takes a ray to a pixel, whatever their scale. M = K R
    (RQ decomposition) with K upper triangular: K is the camera, R its tilt against the one that
    the points are given in.
    """
    rays = projection[[0, 1, 3], :3]
    if not np.isfinite(projection).all() or abs(np.linalg.det(rays)) < 1e-9:
        return "numbers that are no projection"
    # To pixels, whose row 0 is the top; and to x right, y down, z forward.
    to_pixels = np.array(
        [[width / 2, 0, (width - 1) / 2], [0, -height / 2, (height - 1) / 2], [0, 0, 1]]
    )
    matrix = _upper(to_pixels @ rays @ np.diag([1.0, -1.0, -1.0]))
    skew = abs(matrix[0, 1] / matrix[1, 1]) * height
    if skew > _MOST_SKEW_PX:
        return f"a projection whose rows are moved by {skew:.1f} pixels against each other"
    numbers = {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2)}
    found: dict[str, Any] = {name: float(matrix[at]) for name, at in numbers.items()}
    if not all(map(math.isfinite, found.values())):
        return "numbers that are no projection"
    return {**found, "width": width, "height": height}


def _upper(matrix: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return K of M = K R, upper triangular with a positive diagonal, K[2, 2] = 1."""
    _, upper = np.linalg.qr(matrix[::-1].T)
    turned = upper.T[::-1, ::-1]
    found: npt.NDArray[np.float64] = turned * np.sign(np.diag(turned))
    return np.asarray(found / found[2, 2])
