"""Readers of raw datasets, by name; a new dataset is one module and one line here."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from nimprep.errors import LayoutError
from nimprep.readers.base import CalibrationOrigin, DatasetInfo, Reader
from nimprep.readers.cameras import CameraSource

__all__ = ["READERS", "CalibrationOrigin", "DatasetInfo", "Reader", "ReaderOptions", "open_reader"]

READERS: dict[str, str] = {
    "gmrp": "rgb/, depth_u16/ and label/ with equal file names",
    "kitti-road": "training/ and testing/ with image_2/, calib/ and gt_image_2/",
    "folder": "anything a --description FILE.json describes",
}
"""Each reader's name and the layout it is for, as `open_reader` and messages say it."""


@dataclass(frozen=True)
class ReaderOptions:
    """Say what a reader should do differently from its layout's defaults.

    Attributes
    ----------
    labels : bool
        Whether labels are read.
    camera : CameraSource, optional
        In place of the dataset's own calibration.
    depth_scale : float, optional
        Metres per raw depth unit, in place of the layout's.
    description : Path, optional
        A folder description; needed by the reader "folder" and by no other.
    target : {"road", "lane"}
        Which of KITTI road's ground truths.
    depth_from : {"auto", "lidar", "stereo", "none"}
        Where KITTI road's depth comes from; "none" = it will not be read.
    sparse : bool
        Leave KITTI road's depth as measured.
    """

    labels: bool = True
    camera: CameraSource | None = None
    depth_scale: float | None = None
    description: Path | None = None
    target: Literal["road", "lane"] = "road"
    depth_from: Literal["auto", "lidar", "stereo", "none"] = "auto"
    sparse: bool = False


def sniff(root: Path) -> str:
    """Return the name of the reader whose layout a folder has.

    Raises
    ------
    LayoutError
        The folder is missing, or has no known layout.
    """
    if not root.is_dir():
        raise LayoutError(f"{root}: expected a dataset's folder, found none")
    if any((root / part / "image_2").is_dir() for part in ("training", "testing")):
        return "kitti-road"
    if (root / "depth_u16").is_dir() or (root / "rgb").is_dir():
        return "gmrp"
    known = "; ".join(f"{name}: {layout}" for name, layout in READERS.items())
    entries = sorted(p.name for p in root.iterdir())[:5]
    found = ", ".join(entries) if entries else "an empty folder"
    raise LayoutError(f"{root}: expected a known layout ({known}), found {found}")


def open_reader(
    root: Path | str, name: str = "auto", options: ReaderOptions | None = None
) -> Reader:
    """Open a raw dataset.

    Parameters
    ----------
    root : Path
        Its folder.
    name : str
        A name in `READERS`; "auto" = "folder" with a description, else by the folder's layout.

    Raises
    ------
    LayoutError
        The folder is not what the reader expects, or there is no reader of that name.
    """
    root, options = Path(root), options or ReaderOptions()
    if name == "auto":
        name = "folder" if options.description else sniff(root)
    if name not in READERS:
        raise LayoutError(f"reader: expected one of {', '.join(READERS)}, found {name!r}")
    if (name == "folder") != (options.description is not None):
        raise LayoutError(
            f"{root}: expected a description with the reader 'folder' and with no other, found "
            f"{options.description or 'none'} with {name!r}"
        )
    if name == "folder":
        from nimprep.readers.description import description_from_file
        from nimprep.readers.folder import FolderReader

        described = description_from_file(options.description or "")
        return FolderReader(
            root,
            described,
            labels=options.labels,
            camera=options.camera,
            depth_scale=options.depth_scale,
        )
    if name == "kitti-road":
        return _open_kitti_road(root, options)
    from nimprep.readers.gmrp import open_gmrp

    return open_gmrp(
        root, labels=options.labels, camera=options.camera, depth_scale=options.depth_scale
    )


def _open_kitti_road(root: Path, options: ReaderOptions) -> Reader:
    from nimprep.readers.kitti_road import KittiRoadReader

    if options.camera is not None or options.depth_scale is not None:
        raise LayoutError(
            f"{root}: expected KITTI road's own calibration and depth unit, found options that "
            "replace them; leave out --camera, --intrinsics and --depth-scale"
        )
    return KittiRoadReader(
        root,
        labels=options.labels,
        target=options.target,
        depth=options.depth_from,
        sparse=options.sparse,
    )
