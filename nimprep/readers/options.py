"""What a user may say of how a raw dataset is read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypedDict

from nimprep.kitti.names import DepthFrom, Target
from nimprep.options import Options, documented, option

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
        None, "Camera file, JSON."
    )
    depth_scale: float | None = option(None, "Metres per raw depth unit.", least=1e-9, most=1000)
    target: Target = option("road", "Which of KITTI road's ground truths.")
    depth_from: DepthFrom = option(
        "auto", "Where KITTI road's depth comes from; auto: depth_u16, else LiDAR, else stereo."
    )
    sparse: bool = option(False, "Leave KITTI road's depth as measured.")


class ReaderKeywords(TypedDict, total=False):
    """Name the fields of `ReaderOptions` as keyword arguments."""

    reader: ReaderName
    description: Path | str | None
    camera: Path | str | tuple[float, float, float, float] | None
    depth_scale: float | None
    target: Target
    depth_from: DepthFrom
    sparse: bool
