"""Readers of raw datasets, by name; a new dataset is one module and one entry here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from inspect import Parameter, signature
from os import PathLike
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Literal, NamedTuple, TypedDict

from nimprep.errors import LayoutError, OptionError
from nimprep.kitti.names import DepthFrom, Target
from nimprep.options import Options, documented, option, options_of
from nimprep.readers.base import CalibrationOrigin, DatasetInfo, Reader
from nimprep.readers.cameras import camera_from, numbers_of
from nimprep.readers.description import MOST_SCALE_M, DistortionRule, Size, metres_per_unit
from nimprep.readers.nearby import nearby_dataset
from nimprep.readers.resizing import size_from
from nimprep.readers.tree import check_root

__all__ = ["READERS", "CalibrationOrigin", "DatasetInfo", "Reader", "ReaderOptions", "open_reader"]


ReaderName = Literal["auto", "gmrp", "kitti-road", "folder"]


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

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.camera is not None and not isinstance(self.camera, (str, PathLike)):
            object.__setattr__(self, "camera", numbers_of(self.camera))
        if self.size is not None:
            object.__setattr__(self, "size", size_from(self.size))


class ReaderKeywords(TypedDict, total=False):
    reader: ReaderName
    description: Path | str | None
    camera: Path | str | tuple[float, float, float, float] | None
    distortion: DistortionRule | None
    size: Size | str | None
    depth_scale: float | None
    label_map: str | None
    target: Target
    depth_from: DepthFrom
    sparse: bool


class Layout(NamedTuple):
    """Describe what a reader is for.

    Attributes
    ----------
    about : str
        What is where, for people.
    open : str
        "module:function", called with the dataset's folder and, by their names, with the options
        of `ReaderOptions` that it takes; with `labels`, `depth` and `official` of `open_reader`.
    marks : tuple of str
        Folders, any of which tells that a dataset has this layout.
    """

    about: str
    open: str
    marks: tuple[str, ...] = ()


READERS: dict[ReaderName, Layout] = {
    "kitti-road": Layout(
        "training/ and testing/ with image_2/, calib/ and gt_image_2/",
        "nimprep.readers.kitti_road:KittiRoadReader",
        ("training/image_2", "testing/image_2"),
    ),
    "gmrp": Layout(
        "rgb/, depth_u16/ and label/ with equal file names",
        "nimprep.readers.gmrp:open_gmrp",
        ("depth_u16", "rgb"),
    ),
    "folder": Layout(
        "anything a --description FILE.json describes", "nimprep.readers.folder:FolderReader"
    ),
}
"""The readers, in the order in which their layouts are looked for."""


def sniff(root: Path) -> ReaderName:
    """Return the name of the reader whose layout a folder has.

    Raises
    ------
    LayoutError
        The folder is missing, or has no known layout.
    """
    check_root(root)
    for name, layout in READERS.items():
        if any((root / mark).is_dir() for mark in layout.marks):
            return name
    known = "; ".join(f"{name}: {layout.about}" for name, layout in READERS.items())
    entries = sorted(p.name for p in root.iterdir())[:5]
    found = ", ".join(entries) if entries else "an empty folder"
    near = nearby_dataset(root)
    step = f"nimprep inspect {root} says what it is" if near is None else f"did you mean {near}?"
    raise LayoutError(f"{root}: expected a known layout ({known}), found {found}; {step}")


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
    name = options.reader
    if name == "auto":
        name = "folder" if options.description else sniff(root)
    make = resolve_name(READERS[name].open)
    parameters = signature(make).parameters
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
        reader: Reader = make(root, **wanted, **given)
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
    return "--camera or --intrinsics" if name == "camera" else f"--{name.replace('_', '-')}"
