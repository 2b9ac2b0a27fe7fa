"""Any dataset of image files, by a description of it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.depth_unit import UNKNOWN_NUMBERS, DepthNumbers
from nimprep.errors import ArrayError, DecodeError, LayoutError, NimprepError
from nimprep.frame import Frame
from nimprep.modality import MODALITIES, Modality
from nimprep.readers.base import DatasetInfo, OfficialSplit, ReaderBase
from nimprep.readers.cameras import GivenCamera
from nimprep.readers.color_names import NamedColors
from nimprep.readers.color_values import color_image, color_notes
from nimprep.readers.depth_values import (
    check_scale_option,
    checked_raw_signs,
    depth_image,
    depth_numbers,
    raw_depth,
)
from nimprep.readers.depth_warp import check_depth_camera
from nimprep.readers.description import (
    CONFIDENCE,
    Description,
    DistortionRule,
    LabelSource,
    Size,
)
from nimprep.readers.description_file import description_from_file
from nimprep.readers.extra_values import extra_image, extra_record
from nimprep.readers.frame_cameras import FrameCameras
from nimprep.readers.frame_gravity import FrameGravity
from nimprep.readers.label_map import map_from_text, with_map
from nimprep.readers.label_probe import label_notes
from nimprep.readers.label_values import label_image
from nimprep.readers.matching import Place, check_group, formatted, group_of, matched_frames
from nimprep.readers.missing import judged
from nimprep.readers.official_splits import official_splits, whole_scenes, without_labelled
from nimprep.readers.orientation import orientation_signs
from nimprep.readers.points import ScannerPlaces, depth_of_points
from nimprep.readers.registration import (
    Cameras,
    Registered,
    camera_of_sizes,
    registered,
    registered_shape,
)
from nimprep.readers.tree import check_root
from nimprep.readers.undistortion import without_border


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
    distortion : {"undistort", "refuse", "rectified"}, optional
    size : "rgb", "depth" or (width, height), optional
        Both in place of the description's.
    depth_scale : float, optional
        Metres per raw depth unit, in place of the description's; depth is then taken as it comes,
        while without it implausible depth is refused.
    label_map : str, optional
        What raw labels mean, "0:0,255:1", in place of the description's map.
    depth : bool
        Whether to read depth; without, it need not be there.
    gravity : (3,), optional
        Direction of gravity in the camera frame, pointing down, in place of the description's.
    official : bool
        Keep the split of the dataset's authors; if not, frames without labels keep theirs alone.

    Raises
    ------
    LayoutError
        A folder is missing or empty. A frame that lacks a file is bad: asking for its files, its
        shape or itself is a `DecodeError`.
    """

    def __init__(
        self,
        root: Path | str,
        description: Description | Path | str,
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
    ) -> None:
        self.root = Path(root)
        check_root(self.root)
        if not isinstance(description, Description):
            description = description_from_file(description)
        description = _relabelled(description, label_map)
        description = description if size is None else replace(description, size=size)
        self._description, self._scale = description, depth_scale
        check_scale_option(depth_scale, description.depth)
        if not depth and "depth" not in (description.size,):
            description = self._description = replace(description, depth=None)
        wanted = {name for name, _ in description.sources()} - (set() if labels else {"label"})
        matched = matched_frames(self.root, description, wanted)
        splits = official_splits(self.root, description, matched, kept=official)
        matched = replace(matched, ids=tuple(i for i in matched.ids if i not in splits.skipped))
        self._matched = judged(self.root, description, matched, splits.of_frame)
        self._splits = splits if official else without_labelled(splits, self._matched)
        self.ids = self._matched.ids
        check_group(self.root, description, self._matched)
        self._cameras = FrameCameras(
            self.root, description.camera, self._matched, camera, distortion
        )
        self._gravity = FrameGravity(self.root, description, self._matched, gravity)
        self._depth_cameras = self._cameras_of_depth(distortion)
        self._colors = NamedColors(self.root, description.label, self._matched)
        self._scanner = ScannerPlaces(self.root, description.depth, self._matched)
        of_depth = {} if self._depth_cameras is None else self._depth_cameras.lacking
        lacking = {**self._colors.lacking, **of_depth, **self._cameras.lacking}
        lacking |= {**self._scanner.lacking, **self._matched.lacking}
        self._matched = replace(self._matched, lacking=lacking)
        if official and description.split_by == "group" and not self._splits.of_frame:
            self._splits = whole_scenes(self._splits, {i: self.group(i) for i in self.ids})
        self.info = DatasetInfo(
            name=description.name,
            classes=description.classes if "label" in self._matched.places else (),
            calibration=self._cameras.origin,
            has_depth="depth" in self._matched.places,
            depth=self._depth_numbers(),
            planes=self._planes(),
            split_by=description.split_by,
            hha_ground=description.hha_ground,
            reference=description.reference,
            notes=(
                *description.notes,
                *self._cameras.notes(),
                *self._distortion_notes(),
                *self._matched.notes,
                *self._splits.notes,
                *self._gravity.notes,
                *self._label_notes(),
                *color_notes(description.rgb),
            ),
        )

    def _depth_numbers(self) -> DepthNumbers:
        depth = self._description.depth
        if depth is None:
            return UNKNOWN_NUMBERS
        places = self._matched.places.get("depth", {})
        return depth_numbers(depth, (places[i] for i in self.ids if i in places), self._scale)

    def _planes(self) -> tuple[Modality, ...]:
        try:
            return tuple(extra_record(n, source) for n, source in self._description.planes.items())
        except ArrayError as error:
            raise LayoutError(f"{self.root}: {error}") from error

    def _label_notes(self) -> tuple[str, ...]:
        labels = self._matched.places.get("label", {})
        stored = {i: labels[i] for i in self.ids if i in labels}
        return label_notes(self.root, stored, self._description)

    def _cameras_of_depth(self, distortion: DistortionRule | None) -> FrameCameras | None:
        depth = self._description.depth
        check_depth_camera(depth, self.root)
        if depth is None or depth.camera is None or "depth" not in self._matched.places:
            return None
        return FrameCameras(self.root, depth.camera, self._matched, distortion=distortion)

    def _distortion_notes(self) -> Iterator[str]:
        """Yield what is said of depth that is warped, and of distortion that is taken out."""
        if self._of_points:
            yield (
                "depth is a laser scanner's, a pixel here and there: normals, HHA and the like "
                "need it filled, --fill linear"
            )
        if self._depth_cameras is not None:
            yield "depth was taken by another camera: it is warped into colour by depth_to_rgb"
        camera = self._cameras.distorted()
        if camera is None or camera.distortion is None or not self.ids:
            return
        note = f"distortion undistorted: {camera.distortion} of {Path(camera.where).name}"
        try:
            shape = self.shape(self.ids[0])
            given = camera_of_sizes(camera, self._places(self.ids[0]), self._description)
            lost = without_border(given.camera(*shape, self.ids[0]), camera.distortion)
        except NimprepError:
            # Reading the frame says so.
            yield note
            return
        yield f"{note}; {100 * lost:.1f} % of an image, at its border, show nothing and are none"

    def group(self, frame_id: str) -> str:
        """Return the scene by the description's template or pattern; "" = none."""
        if self._description.groups is not None:
            return self._description.groups.get(frame_id, "")
        pattern = self._description.group
        if pattern is None or "{group}" in pattern:
            return group_of(frame_id, pattern)
        # Without a colour image it is a bad frame, whose other files may say less.
        colored = frame_id in self._matched.places["rgb"]
        return formatted(pattern, self._matched.captured[frame_id]) if colored else ""

    def fixed_split(self, frame_id: str) -> OfficialSplit | None:
        """Return the split the dataset's authors put the frame in."""
        return self._splits.of_frame.get(frame_id)

    def sources(self, frame_id: str) -> tuple[Path, ...]:
        """Return the frame's image files and the camera files that hold for it.

        Raises
        ------
        DecodeError
            It lacks one.
        """
        images = (place.path for place in self._places(frame_id).values())
        of_depth = self._depth_cameras.sources(frame_id) if self._depth_cameras else ()
        told = (*self._colors.sources(frame_id), *self._gravity.sources(frame_id))
        said = (*self._cameras.sources(frame_id), *of_depth, *told)
        said += self._scanner.sources(frame_id)
        return tuple(dict.fromkeys((*images, *said)))

    def shape(self, frame_id: str) -> tuple[int, int]:
        """Return (height, width) of the frame's images, from headers."""
        return registered_shape(self._places(frame_id), self._description)

    def _places(self, frame_id: str) -> dict[str, Place]:
        if frame_id in self._matched.lacking:
            raise DecodeError(self._matched.lacking[frame_id])
        return self._matched.of(frame_id)

    def read(self, frame_id: str, modalities: Collection[str] = MODALITIES) -> Frame:
        """Return the frame's rgb, depth_m, label and planes, as far as `modalities` names them."""
        places = self._places(frame_id)
        camera = camera_of_sizes(self._cameras.of(frame_id), places, self._description)
        wanted = {*modalities, CONFIDENCE}
        of_depth = None if self._depth_cameras is None else self._depth_cameras.of(frame_id)
        chosen = {n: p for n, p in places.items() if n in wanted}
        scan = chosen.pop("depth", None) if self._of_points else None
        labels = self._colors.source(frame_id) if "label" in chosen else None
        images, signs = self._images(chosen, of_depth or camera, labels)
        absent = {n for n in self._matched.places if n in modalities and n not in places}
        if not images:
            made = Registered({}, camera.camera(*self.shape(frame_id), frame_id))
        else:
            cameras = Cameras(camera, of_depth)
            made = registered(frame_id, images, places, cameras, self._description)
        images = {**made.images, **self._none(absent, made.camera.shape)}
        if scan is not None and self._description.depth is not None:
            images["depth"] = depth_of_points(
                scan, self._description.depth, self._scanner.of(frame_id), camera, made.camera
            )
        return replace(
            self._frame(frame_id, made.camera, images, camera),
            absent=frozenset(absent),
            signs={**signs, **orientation_signs(places, self._description)},
        )

    @property
    def _of_points(self) -> bool:
        return self._description.depth is not None and self._description.depth.of_points

    def _none(self, names: Collection[str], shape: tuple[int, int]) -> dict[str, npt.NDArray[Any]]:
        """Return images of a frame that has none of these kinds."""
        return {
            name: np.full(shape, np.nan, np.float32)
            if name in self._description.planes
            else MODALITIES[name].blank(shape)
            for name in names
        }

    def _frame(
        self,
        frame_id: str,
        camera: Camera,
        images: Mapping[str, npt.NDArray[Any]],
        given: GivenCamera,
    ) -> Frame:
        return Frame(
            id=frame_id,
            camera=camera,
            rgb=images.get("rgb"),
            depth_m=images.get("depth"),
            label=images.get("label"),
            group=self.group(frame_id),
            baseline_m=given.baseline_m,
            cam_to_road=given.transform(),
            gravity=self._gravity.of(frame_id, given.gravity),
            others={n: images[n] for n in self._description.planes if n in images},
        )

    def _images(
        self, places: dict[str, Place], camera: GivenCamera, labels: LabelSource | None
    ) -> tuple[dict[str, npt.NDArray[Any]], dict[str, float]]:
        """Decode what is wanted of a frame, each image as its file's size, and depth's signs."""
        described = self._description
        images: dict[str, npt.NDArray[Any]] = {}
        signs: dict[str, float] = {}
        if "rgb" in places:
            images["rgb"] = color_image(places["rgb"], described.rgb)
        if "depth" in places and described.depth is not None:
            raw = raw_depth(places["depth"], described.depth)
            signs = checked_raw_signs(raw, places["depth"], described.depth, self.root, self._scale)
            images["depth"] = depth_image(
                places["depth"],
                described.depth,
                raw,
                camera,
                scale_m=self._scale,
                confidence=places.get(CONFIDENCE),
            )
        if "label" in places and labels is not None:
            images["label"] = label_image(places["label"], labels, described.classes)
        for name, source in described.planes.items():
            if name in places:
                images[name] = extra_image(places[name], name, source)
        return images, signs


def _relabelled(description: Description, label_map: str | None) -> Description:
    """Return the description with another map of labels, where one is given."""
    if label_map is None or description.label is None:
        return description
    named = map_from_text(label_map)
    label = with_map(description.label, named, description.classes, "--label-map")
    return replace(description, label=replace(label, names=None, named={}))
