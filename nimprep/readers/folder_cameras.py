"""Cameras that a description says itself: numbers, a width of view, or one for each folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

from nimprep.readers.cameras import GivenCamera, camera_from_document
from nimprep.readers.description import CameraSource, DistortionRule
from nimprep.readers.matching import Matched


class FolderCameras(NamedTuple):
    """Hold the cameras of frames, and of which there is none, as whole messages."""

    of_frame: Mapping[str, GivenCamera]
    lacking: Mapping[str, str]


def described_camera(source: CameraSource, where: str) -> GivenCamera:
    """Return the camera that is no file.

    Raises
    ------
    CameraError
        A number cannot be.
    """
    if source.fov_deg is not None:
        made = GivenCamera("file", where, fov_deg=source.fov_deg)
    else:
        made = camera_from_document(source.numbers, where, source)
    return made if source.nominal is None else replace(made, origin="nominal", where=source.nominal)


def cameras_by_folder(
    root: Path, source: CameraSource, matched: Matched, distortion: DistortionRule | None
) -> FolderCameras:
    """Return each frame's camera, by the folders that its colour image lies in.

    A size in it is the usual one: images of its shape have the numbers scaled, others have them as
    they are, as what was cut off is not known.

    Parameters
    ----------
    distortion : {"undistort", "refuse", "rectified"}, optional
        In place of what each camera says.

    Raises
    ------
    CameraError
        A number cannot be.
    """
    cameras = {}
    for pattern, each in source.folders:
        said = each if distortion is None else replace(each, distortion=distortion)
        made = described_camera(said, f"{root}: 'camera' of folders {pattern!r}")
        cameras[pattern.lower()] = replace(made, scales=True, usual=True)
    own, of_frame, lacking = root.resolve(), {}, {}
    for frame_id, place in matched.places["rgb"].items():
        names = (own.name, *place.path.relative_to(root).parts[:-1])
        fitting = (p for p in cameras if any(fnmatchcase(name.lower(), p) for name in names))
        found = next(fitting, None)
        if found is None:
            known = ", ".join(cameras)
            lacking[frame_id] = (
                f"{place.path}: expected a folder like {known}, which tell its camera, found none; "
                "give --camera"
            )
        else:
            of_frame[frame_id] = cameras[found]
    return FolderCameras(of_frame, lacking)
