"""Readers of raw datasets, by name; most are a file in datasets/, see CONTRIBUTING.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from inspect import Parameter
from numbers import Integral
from os import PathLike
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, TypedDict

from nimprep.camera import unit_gravity
from nimprep.errors import ArrayError, LayoutError, OptionError
from nimprep.kitti.names import DepthFrom, Target
from nimprep.options import Options, documented, option, options_of
from nimprep.readers.base import CalibrationOrigin, DatasetInfo, Reader
from nimprep.readers.cameras import camera_from, numbers_of
from nimprep.readers.datasets import FLAGS, defaults_of, having, label_sets
from nimprep.readers.description import MOST_SCALE_M, DistortionRule, Size, metres_per_unit
from nimprep.readers.layouts import READERS, Layout, ReaderName
from nimprep.readers.recognition import known_file, place_of, recognised
from nimprep.readers.resizing import size_from
from nimprep.readers.signs import Listings

__all__ = [
    "READERS",
    "CalibrationOrigin",
    "DatasetInfo",
    "Layout",
    "Reader",
    "ReaderName",
    "ReaderOptions",
    "open_reader",
]


@documented
@dataclass(frozen=True, kw_only=True)
class ReaderOptions(Options):
    """Say what a reader should do differently from its layout's defaults.

    SRC is the dataset. `camera` may also be (fx, fy, cx, cy), in pixels.
    """

    reader: ReaderName = option("auto", "Layout of SRC; default: by its folders.")
    description: Path | str | None = option(
        None, "JSON description of a folder dataset (schemas/folder.schema.json)."
    )
    camera: Path | str | tuple[float, float, float, float] | None = option(
        None, "Camera file: JSON, ROS or OpenCV YAML, COLMAP, KITTI, or numbers alone."
    )
    gravity: tuple[float, float, float] | None = option(
        None,
        "Direction of gravity in the camera frame, x right, y down, z forward: 0,1,0 where it is "
        "level; default: as SRC says, else estimated.",
        metavar="X,Y,Z",
    )
    distortion: DistortionRule | None = option(
        None,
        "What to do about a camera's distortion: take it out of the images, refuse it, or "
        "nothing, as the images have none left; default: undistort.",
    )
    size: Size | str | None = option(
        None,
        "Bring registered images of different size to one: rgb, depth or WxH; default: refuse.",
        metavar="rgb|depth|WxH",
    )
    depth_scale: float | None = option(
        None,
        "Metres per raw depth unit: 0.001 for millimetres, not 1000.",
        least=1e-9,
        most=MOST_SCALE_M,
        beyond=metres_per_unit,
    )
    label_map: str | None = option(
        None, "Raw label values, ranges or colours to class ids: 0:0,128-255:1,#ff0000:2."
    )
    target: Target = option("road", "Which of KITTI road's ground truths.")
    depth_from: DepthFrom = option(
        "auto", "Where KITTI road's depth comes from; auto: depth_u16, else LiDAR, else stereo."
    )
    sparse: bool = option(False, "Leave KITTI road's depth as measured.")
    label_set: str | None = option(
        None, f"Which labels of a dataset that has several: {label_sets()}.", flag="labels"
    )
    variations: Sequence[str] | str | None = option(
        None, f"Comma-separated, of {having('variations')}; default: {defaults_of('variations')}."
    )
    camera_index: int | None = option(
        None,
        f"Which camera, of {having('camera_index')}; default: {defaults_of('camera_index')}; "
        "--camera N is the same.",
        least=0,
        most=99,
    )
    lists: Path | str | None = option(
        None,
        f"File or folder of the official lists of {having('lists')}, if they are not beside SRC.",
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "camera", self._camera_chosen())
        super().__post_init__()
        if isinstance(self.variations, str):
            object.__setattr__(self, "variations", self.variations.split(","))
        if self.variations is not None:
            object.__setattr__(self, "variations", tuple(map(str, self.variations)))
        if self.camera is not None and not isinstance(self.camera, (str, PathLike)):
            object.__setattr__(self, "camera", numbers_of(self.camera))
        if self.gravity is not None:
            x, y, z = unit_gravity(self.gravity).tolist()
            object.__setattr__(self, "gravity", (x, y, z))
        if self.size is not None:
            object.__setattr__(self, "size", size_from(self.size))

    def _camera_chosen(self) -> Any:
        """Return the camera's file or numbers; a number alone is its index, unless it is a file."""
        given: Any = self.camera
        written = str(given) if isinstance(given, (str, PathLike)) else ""
        if written.isdecimal() and not Path(written).exists():
            given = int(written)
        if not isinstance(given, Integral) or isinstance(given, bool):
            return given
        if self.camera_index not in (None, given):
            raise ArrayError(
                f"camera_index: expected it or a number as camera, found {self.camera_index} and "
                f"{given}; leave one out"
            )
        object.__setattr__(self, "camera_index", int(given))
        return None


class ReaderKeywords(TypedDict, total=False):
    reader: ReaderName
    description: Path | str | None
    camera: Path | str | tuple[float, float, float, float] | None
    gravity: tuple[float, float, float] | None
    distortion: DistortionRule | None
    size: Size | str | None
    depth_scale: float | None
    label_map: str | None
    target: Target
    depth_from: DepthFrom
    sparse: bool
    label_set: str | None
    variations: Sequence[str] | str | None
    camera_index: int | None
    lists: Path | str | None


def open_reader(
    root: Path | str,
    options: ReaderOptions | None = None,
    *,
    labels: bool = True,
    depth: bool = True,
    official: bool = True,
) -> Reader:
    """Open a raw dataset.

    Parameters
    ----------
    root : Path
        Its folder.
    options : ReaderOptions, optional
        Reader "auto" = "folder" with a description, else by the folder's layout.
    labels, depth : bool
        Whether they will be read; if not, they need not be there.
    official : bool
        Whether the split of the dataset's authors is to be kept, where readers can tell.

    Raises
    ------
    LayoutError
        The folder is not what the reader expects.
    OptionError
        The reader does not take an option that is given, or needs one that is not.
    CameraError
        The camera's file or numbers make no camera.
    """
    root, options = Path(root), options or ReaderOptions()
    name, place = options.reader, root
    if name == "auto":
        name, place = ("folder", root) if options.description else recognised(root)
    elif (known := known_file(root)) is not None and known.reader == name:
        place = known.root
    elif READERS[name].signs:
        place = place_of(READERS[name], root, Listings()) or root
    layout = READERS[name]
    parameters = layout.parameters()
    given = {
        each.name: value
        for each in options_of(ReaderOptions).values()
        if each.name != "reader" and (value := getattr(options, each.name)) != each.default
    }
    _check_taken(name, given, parameters)
    if "camera" in given:
        given["camera"] = camera_from(given["camera"], options.distortion)
    asked = (("labels", labels), ("depth", depth), ("official", official))
    wanted = {name: value for name, value in asked if name in parameters}
    try:
        make = resolve_name(layout.open)
        reader: Reader = make(place, **layout.keywords(), **wanted, **given)
    except LayoutError as error:
        if options.reader == "auto" and not options.description:
            error.add_note(f"nimprep inspect {root} says what is there")
        raise
    return reader


def _check_taken(
    reader: str, given: Mapping[str, Any], parameters: Mapping[str, Parameter]
) -> None:
    """Raise `OptionError` where a reader does not take what is given, or is not given all."""
    options = [name for name in options_of(ReaderOptions) if name in parameters]
    known = ", ".join(map(_flag, options))
    for name in (name for name in given if name not in options):
        raise OptionError(
            f"{_flag(name)}: expected options of the reader {reader} ({known}), found "
            f"{str(given[name])!r}; leave out {_flag(name)}"
        )
    for name in options:
        if name not in given and parameters[name].default is Parameter.empty:
            raise OptionError(f"{_flag(name)}: expected it with the reader {reader}, found none")


def _flag(name: str) -> str:
    if name == "camera":
        return "--camera or --intrinsics"
    return FLAGS.get(name, f"--{name.replace('_', '-')}")
