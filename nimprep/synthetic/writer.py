"""Synthetic frames as a folder in GMRP's raw layout."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from nimprep.camera import D415_HORIZONTAL_FOV_DEG, Camera
from nimprep.errors import NimprepError
from nimprep.folders import whole_folder
from nimprep.frame import MAX_PIXELS
from nimprep.parallel import available_cores, map_in_order
from nimprep.synthetic.render import MIN_SIDE, SyntheticFrame, check_number, render_frame

MAX_THREADS = 8
"""Each holds about 200 bytes per pixel while it renders, together at most `MAX_PIXELS` pixels."""


def write_synthetic(
    out_dir: str | os.PathLike[str],
    frames: int,
    seed: int = 0,
    size: tuple[int, int] = (480, 640),
    normals: bool = False,
    noise: bool = True,
    labels: bool = True,
    progress: Callable[[int], object] | None = None,
) -> Path:
    """Write synthetic frames as a folder in GMRP's raw layout.

    ::

        out_dir/
          camera.json              fx, fy, cx, cy, width, height: pixels
          rgb/000000.png           8-bit colour
          depth_u16/000000.png     16-bit grey, millimetres, 0 = no depth
          label/000000.png         8-bit grey: 0 background, 1 drivable area, 2 road anomaly
          normal/000000.npy        with normals: (H, W, 3) float32, exact unit normals
          depth_exact/000000.npy   with normals: (H, W) float32, exact z-depth in metres

    The exact arrays are NumPy files, not images, so that they are exact: the normals are in the
    camera frame (x right, y down, z forward) and point at the camera; (0, 0, 0) and depth 0 = the
    sky.

    Parameters
    ----------
    out_dir : path
        A folder that does not exist yet, or is empty.
    frames : int
        How many; at least 1. Frame i depends on the seed, i and the size alone.
    seed : int
        Which series of scenes; 0 or more.
    size : (height, width), pixels
        At least (16, 16). The camera is the nominal RealSense D415 at this size.
    normals : bool
        Whether to write the exact normals and depth too.
    noise : bool
        Whether picture and depth have the errors of real sensors; without, depth is the exact one,
        rounded to millimetres.
    labels : bool
        Whether to write labels.
    progress : callable, optional
        Called in this thread with 1 for each frame that is done, as `tqdm.update` would be.

    Returns
    -------
    Path
        The folder. It is whole or not there; in an empty one that was there, `rgb` comes last.

    Raises
    ------
    LayoutError
        `out_dir` is a file, a folder with something in it, lies in a store, or cannot be written.
    NimprepError
        Numbers out of range.
    """
    out = Path(out_dir)
    check_number("frames", frames, 1)
    check_number("seed", seed, 0)
    for name, side in zip(("height", "width"), size, strict=True):
        check_number(name, side, MIN_SIDE)
    if size[0] * size[1] > MAX_PIXELS:
        raise NimprepError(
            f"synthetic size: expected at most {MAX_PIXELS} pixels, found {size[1]}x{size[0]}"
        )
    camera = Camera.from_fov(D415_HORIZONTAL_FOV_DEG, size[1], size[0])
    kinds = _kinds(normals, labels)
    try:
        with whole_folder(out) as partial:
            for kind in kinds:
                (partial / kind).mkdir()
            (partial / "camera.json").write_text(json.dumps(camera.to_dict(), indent=2) + "\n")
            _write_frames(partial, kinds, frames, seed, camera, noise, progress)
    except MemoryError as error:
        raise NimprepError(
            f"{out}: expected memory for frames of {size[1]}x{size[0]} pixels, found too little; "
            "ask for smaller ones"
        ) from error
    return out


def _kinds(normals: bool, labels: bool) -> list[str]:
    """Return the folders to write."""
    return [
        *(["normal", "depth_exact"] if normals else []),
        *(["label"] if labels else []),
        "depth_u16",
        "rgb",
    ]


def _write_frames(
    folder: Path,
    kinds: list[str],
    frames: int,
    seed: int,
    camera: Camera,
    noise: bool,
    progress: Callable[[int], object] | None,
) -> None:
    """Write every frame: threads share the work, as NumPy and the encoder let go of the lock."""

    def write(index: int) -> None:
        _write_frame(folder, kinds, f"{index:06d}", render_frame(seed, index, camera, noise))

    at_once = max(1, MAX_PIXELS // (camera.height * camera.width))
    threads = min(available_cores(), MAX_THREADS, frames, at_once)
    for _ in map_in_order(write, range(frames), threads):
        if progress is not None:
            progress(1)


def _write_frame(folder: Path, kinds: list[str], frame_id: str, frame: SyntheticFrame) -> None:
    millimetres = np.rint(frame.depth_m * np.float32(1000)).astype(np.uint16)
    images = {"rgb": frame.rgb[..., ::-1], "depth_u16": millimetres, "label": frame.label}
    arrays = {"normal": frame.normal, "depth_exact": frame.depth_exact_m}
    for kind in kinds:
        if kind in images:
            (folder / kind / f"{frame_id}.png").write_bytes(_png(images[kind]))
        else:
            np.save(folder / kind / f"{frame_id}.npy", arrays[kind])


def _png(image: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> bytes:
    # Encoded in memory: unlike cv2.imwrite, write_bytes tells why it failed.
    _, encoded = cv2.imencode(".png", np.ascontiguousarray(image))
    return encoded.tobytes()
