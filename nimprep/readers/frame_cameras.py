"""The camera of each frame of a described dataset: one for all, a file or a row for each."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from nimprep.errors import CameraError, LayoutError, OptionError
from nimprep.readers.base import CalibrationOrigin
from nimprep.readers.camera_formats import CameraNumbers, CameraTable, numbers_from_file
from nimprep.readers.cameras import (
    GivenCamera,
    camera_from_document,
    camera_from_numbers,
    nominal_camera,
)
from nimprep.readers.description import CameraSource, DistortionRule
from nimprep.readers.folder_cameras import cameras_by_folder, described_camera
from nimprep.readers.matching import Matched, files_for

_KEPT = 64
"""Files whose contents are kept: frames of a scene share a file, and come one after the other."""


class FrameCameras:
    """Give the camera of each frame; `lacking` says of which there is none, as whole messages.

    Parameters
    ----------
    root : Path
        The dataset's folder.
    source : CameraSource, optional
        None = the nominal RealSense D415.
    matched : Matched
        The frames.
    given : GivenCamera, optional
        In place of the source's, for all.
    distortion : {"undistort", "refuse", "rectified"}, optional
        In place of what the source says.

    Raises
    ------
    LayoutError
        No frame has a camera.
    CameraError
        The file for all is no camera.
    OptionError
        The dataset has none, and none is given.
    """

    def __init__(
        self,
        root: Path,
        source: CameraSource | None,
        matched: Matched,
        given: GivenCamera | None = None,
        distortion: DistortionRule | None = None,
    ) -> None:
        if source is not None and distortion is not None:
            source = replace(source, distortion=distortion)
        self._source = source or CameraSource()
        self._captured = matched.captured
        self.lacking: Mapping[str, str] = {}
        self._files: Mapping[str, Path] = {}
        self._shared: tuple[Path, ...] = ()
        self._read: dict[Path, CameraNumbers | CameraTable] = {}
        self._lock = threading.Lock()
        self._by_frame: Mapping[str, GivenCamera] = {}
        self._camera = given or self._described(root, source, matched, distortion)

    def _described(
        self,
        root: Path,
        source: CameraSource | None,
        matched: Matched,
        distortion: DistortionRule | None,
    ) -> GivenCamera | None:
        if source is None:
            return nominal_camera()
        if source.unknown:
            raise OptionError(
                f"{root}: expected --camera FILE or --intrinsics fx,fy,cx,cy, as this dataset "
                "does not say its camera, found neither; give one of the two"
            )
        if source.folders:
            self._by_frame, self.lacking = cameras_by_folder(root, source, matched, distortion)
            return None
        if source.table is not None:
            self._by_frame, self.lacking = cameras_of_table(source, matched)
            self._shared = () if source.table_file is None else (source.table_file,)
            return None
        if source.files is None:
            return described_camera(source, f"{root}: 'camera'")
        if not any(mark in source.files for mark in "{*?"):
            if ".." in source.files.split("/"):
                raise LayoutError(
                    f"{root}: expected a camera file below the folder, found {source.files!r}"
                )
            self._shared = (root / source.files,)
            found = numbers_from_file(self._shared[0], source)
            if isinstance(found, CameraNumbers):
                return camera_from_numbers(found, str(self._shared[0]), source)
            self._files = dict.fromkeys(matched.ids, self._shared[0])
            self._read[self._shared[0]] = found
            return None
        places = files_for(root, source.files, matched.captured)
        self._files = {frame_id: place.path for frame_id, place in places.items()}
        lacking = [i for i in matched.ids if i not in self._files]
        if len(lacking) == len(matched.ids):
            raise LayoutError(
                f"{root}: expected a camera of every frame, found none of any; check the pattern "
                f"{source.files!r}"
            )
        self.lacking = {
            i: f"{root}: expected a camera of frame {i!r} like {source.files!r}, found none"
            for i in lacking
        }
        return None

    @property
    def origin(self) -> CalibrationOrigin:
        """Where cameras come from: file, nominal or user."""
        if self._camera is not None:
            return self._camera.origin
        nominal = any(each.origin == "nominal" for each in self._by_frame.values())
        return "nominal" if nominal else "file"

    def notes(self) -> Iterator[str]:
        """Yield what is said of cameras that nobody calibrated."""
        nominal = [i for i, each in self._by_frame.items() if each.origin == "nominal"]
        if self.origin == "nominal":
            camera = self._camera or self._by_frame[nominal[0]]
            of = f" of {len(nominal)} frames, first {nominal[0]!r}" if nominal else ""
            yield (
                f"no calibration{of}: assuming {camera.where}; give --camera FILE.json or "
                "--intrinsics fx,fy,cx,cy if you know better"
            )

    def of(self, frame_id: str) -> GivenCamera:
        """Return the camera of a frame.

        Raises
        ------
        CameraError
            Its file is no camera.
        """
        if self._camera is not None:
            return self._camera
        if self._by_frame:
            return self._by_frame[frame_id]
        path = self._files[frame_id]
        found = self._contents(path)
        if isinstance(found, CameraTable):
            found = found.of(self._captured.get(frame_id, {}))
        return camera_from_numbers(found, str(path), self._source)

    def _contents(self, path: Path) -> CameraNumbers | CameraTable:
        with self._lock:
            if path in self._read:
                return self._read[path]
        found = numbers_from_file(path, self._source)
        with self._lock:
            while len(self._read) >= _KEPT:
                del self._read[next(iter(self._read))]
            self._read[path] = found
        return found

    def sources(self, frame_id: str) -> tuple[Path, ...]:
        """Return the files that say it."""
        return (self._files[frame_id],) if self._files else self._shared

    def distorted(self) -> GivenCamera | None:
        """Return the first frame's camera, if its images are distorted, None if not."""
        try:
            first = self._camera or self.of(next(iter(self._files or self._by_frame)))
        except (CameraError, StopIteration):
            return None
        return first if first.distortion is not None else None


def cameras_of_table(
    source: CameraSource, matched: Matched
) -> tuple[dict[str, GivenCamera], dict[str, str]]:
    """Return the camera of each frame by the numbers that code knows, and of which there is none.

    Returns
    -------
    cameras : dict of frame id to GivenCamera
    lacking : dict of frame id to whole message

    Raises
    ------
    CameraError
        A number cannot be.
    """
    table, where = source.table or {}, str(source.table_file)
    made = {
        value: camera_from_document(numbers, where, source)
        for value, numbers in table.items()
        if not isinstance(numbers, str)
    }
    cameras, lacking = {}, {}
    for i in matched.ids:
        value = matched.captured[i].get(source.by, "")
        if value in made:
            cameras[i] = made[value]
        else:
            found = table.get(value, f"none of {value!r}")
            lacking[i] = f"{where}: expected the camera of frame {i!r}, found {found}"
    return cameras, lacking
