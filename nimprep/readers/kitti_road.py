"""The KITTI road benchmark (Fritsch et al., ITSC 2013), as data_road.zip unpacks::

data_road/
  training/
    image_2/um_000000.png            left colour camera; um, umm or uu
    calib/um_000000.txt              P2, P3, R0_rect, Tr_velo_to_cam, Tr_cam_to_road
    gt_image_2/um_road_000000.png    red > 0: evaluated; blue > 0: road
    gt_image_2/um_lane_000000.png    the lane, for um only
    depth_u16/um_000000.png          optional: dense depth, millimetres; 0 and 65535 = none
    velodyne/um_000000.bin           optional: laser scan (data_road_velodyne.zip)
    image_3/um_000000.png            optional: right colour camera (data_road_right.zip)
  testing/                           the same without gt_image_2
  validation/ or validating/         optional: as training, held out by somebody

Images may have other endings: what is lossless for labels and depth, any for colour.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import unit_gravity
from nimprep.depth_unit import DepthNumbers
from nimprep.errors import DecodeError, LayoutError
from nimprep.frame import IGNORE_LABEL, Frame, LabelClass
from nimprep.images import read_header, read_rgb
from nimprep.kitti.calibration import Calibration, read_calibration
from nimprep.kitti.depth import (
    DepthOrigin,
    check_frame_size,
    choose_origin,
    frame_depth,
    origin_file,
)
from nimprep.kitti.images import read_ground_truth
from nimprep.kitti.layout import RoadFiles, list_road_files
from nimprep.kitti.names import TARGETS, DepthFrom, Target, frame_category
from nimprep.modality import MODALITIES
from nimprep.readers.base import DatasetInfo, ReaderBase
from nimprep.readers.reference import Reference
from nimprep.splits import SplitName

_BENCHMARK: dict[str, SplitName] = {"testing": "test"}

_HELD_OUT: dict[str, SplitName] = {
    **_BENCHMARK,
    "training": "train",
    "validation": "val",
    "validating": "val",
}

REFERENCE = Reference(
    title="KITTI road benchmark",
    licence="CC BY-NC-SA 3.0",
    citation="J. Fritsch, T. Kuehnl and A. Geiger. A New Performance Measure and Evaluation "
    "Benchmark for Road Detection Algorithms. ITSC 2013.",
    paper="https://doi.org/10.1109/ITSC.2013.6728473",
    url="https://www.cvlibs.net/datasets/kitti/eval_road.php",
)


def _classes(target: Target) -> tuple[LabelClass, ...]:
    return (
        LabelClass(0, f"not {target}", (0, 0, 0)),
        LabelClass(1, target, (0, 200, 0)),
    )


class KittiRoadReader(ReaderBase):
    """Read KITTI road frames; ids are ``training/um_000000``, groups the categories.

    Where there is a folder validation or validating, its frames are val and training's train. Else
    an eighth of each category's training frames is for val (of all 289: 253 train, 36 val; in the
    order of their names the last 36 would all be uu); the testing frames are the test split.

    Depth is depth_u16 where it is there, else the LiDAR scan, else stereo, both interpolated
    linearly (`nimprep.kitti.depth`). Labels are 0 not road, 1 road, 255 outside the evaluated area;
    testing frames, whose ground truth the benchmark keeps, are 255 throughout.

    Parameters
    ----------
    root : Path
        The folder with training/, testing/ or both.
    labels : bool
        Whether to read gt_image_2; without, it need not be there.
    target : {"road", "lane"}
        Which ground truth; lane takes the um frames alone.
    depth : bool
        Whether depth will be read; if not, nothing need be there for it.
    official : bool
        Keep the split by a folder for validation; if not, testing frames keep theirs alone.
    depth_from : {"auto", "lidar", "stereo"}
        Where it comes from.
    sparse : bool
        Leave LiDAR and stereo as measured.
    gravity : (3,), optional
        Direction of gravity in the camera frame, pointing down, in place of the calibration's.

    Raises
    ------
    LayoutError
        No frames, a name that is none of the benchmark's, or no frame that has all its files. One
        that lacks a file is bad: asking for its files, its shape or itself is a `DecodeError`.
    """

    def __init__(
        self,
        root: Path | str,
        *,
        labels: bool = True,
        target: Target = "road",
        depth: bool = True,
        depth_from: DepthFrom = "auto",
        sparse: bool = False,
        official: bool = True,
        gravity: Sequence[float] | None = None,
    ) -> None:
        self.root = Path(root)
        self._gravity = None if gravity is None else unit_gravity(gravity)
        self._labels, self._target, self._sparse = labels, target, sparse
        self._files: dict[str, RoadFiles] = {}
        self._depth: dict[str, DepthOrigin] = {}
        self._lacking: dict[str, str] = {}
        for files in list_road_files(self.root, calibrated=False):
            category = frame_category(files.name)
            if category is None:
                raise LayoutError(
                    f"{files.image}: expected a name <um|umm|uu>_<six digits>.png, "
                    f"found {files.image.name!r}"
                )
            if category in TARGETS[target]:
                self._add(files, depth_from if depth else None)
        if not self._files:
            raise LayoutError(f"{self.root}: expected um frames for the target lane, found none")
        if len(self._lacking) == len(self._files):
            raise LayoutError(self._lacking[min(self._lacking)])
        self.ids = tuple(sorted(self._files))
        there = {files.split for files in self._files.values()}
        held_out = official and not there.isdisjoint(("validation", "validating"))
        self._splits = _HELD_OUT if held_out else _BENCHMARK
        self.info = DatasetInfo(
            "kitti-road",
            _classes(target) if labels else (),
            "file",
            split_by="eighth",
            depth=DepthNumbers(certain=True),
            reference=REFERENCE,
        )

    def _add(self, files: RoadFiles, depth_from: DepthFrom | None) -> None:
        self._files[files.id] = files
        if not files.calibration.is_file():
            self._lacking[files.id] = (
                f"{files.calibration}: expected the calibration of frame {files.id}, found none"
            )
        if depth_from is not None:
            try:
                self._depth[files.id] = choose_origin(files, depth_from, self._sparse)
            except LayoutError as error:
                self._lacking[files.id] = str(error)
        truth = files.ground_truth(self._target)
        if self._labels and files.split != "testing" and not truth.is_file():
            self._lacking[files.id] = (
                f"{truth}: expected the ground truth of frame {files.id}, found none; "
                "use --no-labels to convert without"
            )

    def _whole(self, frame_id: str) -> RoadFiles:
        """Return the files of a frame that has them all."""
        if frame_id in self._lacking:
            raise DecodeError(self._lacking[frame_id])
        return self._files[frame_id]

    def shape(self, frame_id: str) -> tuple[int, int]:
        """Return (height, width) of the frame's images, from a header."""
        header = read_header(self._whole(frame_id).image)
        return header.height, header.width

    def group(self, frame_id: str) -> str:
        """Return the category: um, umm or uu."""
        return frame_category(self._files[frame_id].name) or ""

    def fixed_split(self, frame_id: str) -> SplitName | None:
        """Return "test" for testing frames; of others what a folder for validation says."""
        return self._splits.get(self._files[frame_id].split)

    def depth_source(self, frame_id: str) -> DepthOrigin | None:
        """Return where the frame's depth comes from; None = depth is not read."""
        return self._depth.get(frame_id)

    def calibration(self, frame_id: str) -> Calibration:
        """Return the frame's calibration, the file's matrices included.

        Raises
        ------
        DecodeError
            The file is bad.
        """
        return read_calibration(self._files[frame_id].calibration)

    def metadata(self, frame_id: str) -> dict[str, Any]:
        """Return what else is known of the frame, for JSON: depth's source, the raw matrices."""
        if frame_id in self._lacking:
            return {}
        matrices = self.calibration(frame_id).matrices
        return {
            "depth_source": self.depth_source(frame_id),
            "calibration": {name: matrix.tolist() for name, matrix in matrices.items()},
        }

    def sources(self, frame_id: str) -> tuple[Path, ...]:
        """Return the frame's image, calibration, ground truth and what its depth is made of."""
        files = self._whole(frame_id)
        paths = [files.image, files.calibration]
        truth = files.ground_truth(self._target)
        if self._labels and truth.is_file():
            paths.append(truth)
        if frame_id in self._depth:
            paths.append(origin_file(files, self._depth[frame_id]))
        return tuple(paths)

    def read(self, frame_id: str, modalities: Collection[str] = MODALITIES) -> Frame:
        """Return the frame's rgb, depth_m and label, as far as `modalities` names them."""
        files = self._whole(frame_id)
        shape = self.shape(frame_id)
        calibration = read_calibration(files.calibration)
        check_frame_size(shape, calibration, files.image)
        source = self._depth.get(frame_id)
        return Frame(
            id=frame_id,
            camera=calibration.camera(*shape),
            rgb=read_rgb(files.image) if "rgb" in modalities else None,
            depth_m=frame_depth(files, source, self._sparse, far=True)
            if source is not None and "depth" in modalities
            else None,
            label=self._label(files, shape) if self._labels and "label" in modalities else None,
            group=self.group(frame_id),
            baseline_m=calibration.baseline_m if "P3" in calibration.matrices else float("nan"),
            cam_to_road=calibration.cam_to_road if calibration.has_road else None,
            gravity=self._gravity,
        )

    def _label(self, files: RoadFiles, shape: tuple[int, int]) -> npt.NDArray[np.uint8]:
        path = files.ground_truth(self._target)
        if not path.is_file():
            return np.full(shape, IGNORE_LABEL, dtype=np.uint8)
        truth = read_ground_truth(path)
        if truth.positive.shape != shape:
            (high, wide), (height, width) = truth.positive.shape, shape
            raise DecodeError(
                f"{path}: expected {width}x{height} pixels like {files.image}, found {wide}x{high}"
            )
        return np.where(truth.evaluated, truth.positive, IGNORE_LABEL).astype(np.uint8)
