"""Any dataset of one image file per frame and modality, by a description of it."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError, LayoutError
from nimprep.frame import Frame
from nimprep.images import read_depth, read_header, read_label, read_rgb
from nimprep.modality import MODALITIES
from nimprep.readers.base import DatasetInfo, ReaderBase
from nimprep.readers.cameras import (
    GivenCamera,
    camera_from_document,
    camera_from_file,
    nominal_camera,
)
from nimprep.readers.description import (
    Description,
    description_from_file,
    files_by_id,
    group_of,
)
from nimprep.readers.frames import check_label, check_same_shape, depth_in_metres, match_frames

_NOMINAL_NOTE = (
    "no calibration: assuming the nominal RealSense D415 colour camera (69.4 degrees wide); "
    "give --camera FILE.json or --intrinsics fx,fy,cx,cy if you know better"
)


class FolderReader(ReaderBase):
    """Read a dataset that a `Description` describes.

    Parameters
    ----------
    root : Path
        The dataset's folder; every pattern is below it.
    description : Description or path
        What is where, or a file that says it.
    labels : bool
        Whether to read labels; without, they need not be there.
    camera : GivenCamera, optional
        In place of the description's.
    depth_scale : float, optional
        Metres per raw depth unit, in place of the description's; depth is then taken as it comes,
        while without it implausible depth is refused.

    Raises
    ------
    LayoutError
        A folder is missing or empty, or a frame lacks a file.
    """

    def __init__(
        self,
        root: Path | str,
        description: Description | Path | str,
        *,
        labels: bool = True,
        camera: GivenCamera | None = None,
        depth_scale: float | None = None,
    ) -> None:
        self.root = Path(root)
        if not self.root.is_dir():
            raise LayoutError(f"{self.root}: expected a dataset's folder, found none")
        if not isinstance(description, Description):
            description = description_from_file(description)
        self._description = description
        self._scale = depth_scale
        self._files: dict[str, dict[str, Path]] = {
            "rgb": files_by_id(self.root, description.rgb),
            "depth": files_by_id(self.root, description.depth),
        }
        if labels and description.label is not None:
            try:
                self._files["label"] = files_by_id(self.root, description.label)
            except LayoutError as error:
                raise LayoutError(f"{error}; use --no-labels to convert without") from error
        self.ids = match_frames(self._files, self.root)
        self._camera, self._cameras = self._choose_camera(camera)
        origin = self._camera.origin if self._camera else "file"
        self.info = DatasetInfo(
            name=description.name,
            classes=description.classes if "label" in self._files else (),
            calibration=origin,
            notes=(_NOMINAL_NOTE,) if origin == "nominal" else (),
        )

    def _choose_camera(
        self, given: GivenCamera | None
    ) -> tuple[GivenCamera | None, dict[str, Path]]:
        """Return one camera for all frames, or None and a file per frame."""
        described = self._description.camera
        self._shared: tuple[Path, ...] = ()
        if given is not None:
            return given, {}
        if isinstance(described, dict):
            return camera_from_document(described, f"{self.root}: 'camera'"), {}
        if described is None:
            return nominal_camera(), {}
        if "{id}" not in described:
            if ".." in described.split("/"):
                raise LayoutError(
                    f"{self.root}: expected a camera file below the folder, found {described!r}"
                )
            self._shared = (self.root / described,)
            return camera_from_file(self.root / described, pipes=False), {}
        files = files_by_id(self.root, described)
        match_frames({"camera": files, "rgb": self._files["rgb"]}, self.root)
        return None, files

    def group(self, frame_id: str) -> str:
        """Return the scene by the description's pattern; "" = none."""
        return group_of(frame_id, self._description.group)

    def sources(self, frame_id: str) -> tuple[Path, ...]:
        """Return the frame's image files and the camera file that holds for it, where one does."""
        own = (self._cameras[frame_id],) if self._cameras else self._shared
        return (*(files[frame_id] for files in self._files.values()), *own)

    def shape(self, frame_id: str) -> tuple[int, int]:
        """Return (height, width) from the depth image's header."""
        header = read_header(self._files["depth"][frame_id])
        return header.height, header.width

    def read(self, frame_id: str, modalities: Collection[str] = MODALITIES) -> Frame:
        """Return the frame's rgb, depth_m and label, as far as `modalities` names them."""
        paths = {n: files[frame_id] for n, files in self._files.items() if n in modalities}
        decode = {"rgb": read_rgb, "depth": read_depth, "label": read_label}
        raw: dict[str, npt.NDArray[Any]] = {n: decode[n](path) for n, path in paths.items()}
        check_same_shape({paths[n]: image for n, image in raw.items()})
        height, width = next(iter(raw.values())).shape[:2] if raw else self.shape(frame_id)
        intrinsics = self._camera or camera_from_file(self._cameras[frame_id], pipes=False)
        return Frame(
            id=frame_id,
            camera=intrinsics.camera(height, width, frame_id),
            rgb=raw.get("rgb"),
            depth_m=self._metres(raw["depth"], paths["depth"]) if "depth" in raw else None,
            label=self._class_ids(raw["label"], paths["label"]) if "label" in raw else None,
            group=self.group(frame_id),
            baseline_m=intrinsics.baseline_m,
        )

    def _metres(self, raw: npt.NDArray[Any], path: Path) -> npt.NDArray[np.float32]:
        return depth_in_metres(
            raw,
            path,
            scale_m=self._scale or self._description.depth_scale,
            invalid=self._description.depth_invalid,
            check_unit=self._scale is None,
        )

    def _class_ids(self, raw: npt.NDArray[Any], path: Path) -> npt.NDArray[np.uint8]:
        label_map = self._description.label_map
        if label_map is None:
            return check_label(raw, self._description.classes, path)
        if raw.ndim == 3:
            codes = raw.astype(np.int64) @ np.array([1 << 16, 1 << 8, 1])
        else:
            codes = raw.astype(np.int64)
        values, where = np.unique(codes, return_inverse=True)
        mapped = []
        for value in values.tolist():
            key = (value >> 16, value >> 8 & 255, value & 255) if raw.ndim == 3 else value
            known = label_map.get(key, self._description.label_default)
            if known is None:
                raise DecodeError(
                    f"{path}: expected labels of the description's map, found {key}; "
                    "add it to the map, or a 'default'"
                )
            mapped.append(known)
        return np.array(mapped, dtype=np.uint8)[where].reshape(codes.shape)
