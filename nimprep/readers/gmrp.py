"""GMRP's own layout (Wang et al., IROS 2020), and datasets that copy it::

gmrp/
  rgb/000001.png         8-bit colour
  depth_u16/000001.png   16-bit, millimetres; 0 and 65535 = no depth
  label/000001.png       8-bit: 0 background, 1 drivable area, 2 road anomaly
  depth_u8/              ignored: for looking at only
  camera.json            optional; GMRP itself ships no calibration
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from nimprep.frame import LabelClass
from nimprep.readers.cameras import GivenCamera
from nimprep.readers.description import (
    CameraSource,
    ColorSource,
    DepthSource,
    Description,
    DistortionRule,
    LabelSource,
    Size,
)
from nimprep.readers.folder import FolderReader

GMRP = Description(
    name="gmrp",
    rgb=ColorSource(files="rgb/{id}.png"),
    depth=DepthSource(files="depth_u16/{id}.png", scale=0.001, invalid=(0, 65535)),
    label=LabelSource(files="label/{id}.png"),
    classes=(
        LabelClass(0, "background", (0, 0, 0)),
        LabelClass(1, "drivable area", (0, 200, 0)),
        LabelClass(2, "road anomaly", (220, 0, 0)),
    ),
)


def open_gmrp(
    root: Path | str,
    *,
    labels: bool = True,
    camera: GivenCamera | None = None,
    depth_scale: float | None = None,
    label_map: str | None = None,
    distortion: DistortionRule | None = None,
    size: Size | None = None,
    official: bool = True,
    depth: bool = True,
    gravity: Sequence[float] | None = None,
) -> FolderReader:
    """Open a folder in GMRP's layout.

    Parameters are those of `FolderReader`. Without a camera, camera.json is taken where there is
    one, else the nominal RealSense D415, which the dataset was recorded with.
    """
    description = GMRP
    if (Path(root) / "camera.json").is_file():
        description = replace(description, camera=CameraSource(files="camera.json"))
    return FolderReader(
        root,
        description,
        labels=labels,
        camera=camera,
        depth_scale=depth_scale,
        label_map=label_map,
        distortion=distortion,
        size=size,
        official=official,
        depth=depth,
        gravity=gravity,
    )
