"""The camera of each frame of a described dataset: one for all, or a file for each."""

from __future__ import annotations

from pathlib import Path

from nimprep.errors import LayoutError
from nimprep.readers.base import CalibrationOrigin
from nimprep.readers.cameras import (
    GivenCamera,
    camera_from_document,
    camera_from_file,
    nominal_camera,
)
from nimprep.readers.description import CameraSource
from nimprep.readers.frames import match_frames
from nimprep.readers.matching import Matched, files_by_id


class FrameCameras:
    """Give the camera of each frame.

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

    Raises
    ------
    LayoutError
        A frame has no camera.
    CameraError
        The file for all is no camera.
    """

    def __init__(
        self, root: Path, source: CameraSource | None, matched: Matched, given: GivenCamera | None
    ) -> None:
        self._files: dict[str, Path] = {}
        self._shared: tuple[Path, ...] = ()
        self._camera = given
        if given is None:
            self._camera = self._described(root, source, matched)

    def _described(
        self, root: Path, source: CameraSource | None, matched: Matched
    ) -> GivenCamera | None:
        if source is None:
            return nominal_camera()
        if source.files is None:
            return camera_from_document(source.numbers, f"{root}: 'camera'")
        if "{" not in source.files:
            if ".." in source.files.split("/"):
                raise LayoutError(
                    f"{root}: expected a camera file below the folder, found {source.files!r}"
                )
            self._shared = (root / source.files,)
            return camera_from_file(root / source.files, pipes=False)
        self._files = files_by_id(root, source.files)
        colors = {i: place.path for i, place in matched.places["rgb"].items()}
        match_frames({"camera": self._files, "rgb": colors}, root)
        return None

    @property
    def origin(self) -> CalibrationOrigin:
        """Where cameras come from: file, nominal or user."""
        return self._camera.origin if self._camera else "file"

    def of(self, frame_id: str) -> GivenCamera:
        """Return the camera of a frame.

        Raises
        ------
        CameraError
            Its file is no camera.
        """
        return self._camera or camera_from_file(self._files[frame_id], pipes=False)

    def sources(self, frame_id: str) -> tuple[Path, ...]:
        """Return the files that say it."""
        return (self._files[frame_id],) if self._files else self._shared
