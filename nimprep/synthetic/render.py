"""One synthetic frame, from its seed and number alone."""

from __future__ import annotations

import operator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.errors import CameraError, NimprepError
from nimprep.synthetic.raycast import cast, labels, lit, normals_in_camera
from nimprep.synthetic.scene import Scene
from nimprep.synthetic.sensor import measured_depth
from nimprep.synthetic.shading import developed, shaded
from nimprep.synthetic.street import random_street

MIN_SIDE = 16
"""Smallest height and width, pixels."""


@dataclass(frozen=True)
class SyntheticFrame:
    """Hold one synthetic frame: what the sensors deliver, and the truth.

    Attributes
    ----------
    rgb : (H, W, 3) uint8
        Colour, channels R, G, B.
    depth_m : (H, W) float32, metres
        z-depth as a stereo camera measures it, whole millimetres; 0 = no depth. Without noise, the
        same as depth_exact_m.
    depth_exact_m : (H, W) float32, metres
        The surfaces' own z-depth; 0 = the sky.
    normal : (H, W, 3) float32
        The surfaces' own unit normals, in the camera frame (x right, y down, z forward), pointing
        at the camera; (0, 0, 0) = the sky.
    label : (H, W) uint8
        0 background, 1 drivable area, 2 road anomaly.
    """

    rgb: npt.NDArray[np.uint8]
    depth_m: npt.NDArray[np.float32]
    depth_exact_m: npt.NDArray[np.float32]
    normal: npt.NDArray[np.float32]
    label: npt.NDArray[np.uint8]


def render_frame(seed: int, index: int, camera: Camera, noise: bool = True) -> SyntheticFrame:
    """Return frame number `index` of the series `seed`: the same on any machine, in any order.

    Parameters
    ----------
    seed, index : int
        Which series, and which of its frames; 0 or more.
    camera : Camera
        The camera; at least 16 by 16 pixels.
    noise : bool
        Whether picture and depth have the errors of real sensors. The scene does not depend on it.

    Raises
    ------
    NimprepError
        A negative seed or index.
    CameraError
        An image smaller than 16 by 16.
    """
    check_number("seed", seed, 0)
    check_number("index", index, 0)
    for_scene, for_sensors = np.random.default_rng((seed, index)).spawn(2)
    return render_scene(random_street(for_scene), camera, for_sensors, noise)


def render_scene(
    scene: Scene, camera: Camera, rng: np.random.Generator, noise: bool = True
) -> SyntheticFrame:
    """Return what a camera records of a scene.

    Parameters
    ----------
    scene : Scene
        What there is.
    camera : Camera
        The camera; at least 16 by 16 pixels.
    rng : numpy.random.Generator
        Source of the surfaces' grain and of the sensors' errors.
    noise : bool
        Whether picture and depth have the errors of real sensors.

    Raises
    ------
    CameraError
        An image smaller than 16 by 16.
    """
    if min(camera.shape) < MIN_SIDE:
        raise CameraError(
            f"synthetic camera: expected at least {MIN_SIDE}x{MIN_SIDE} pixels, "
            f"found {camera.width}x{camera.height}; ask for a larger image"
        )
    for_texture, for_picture, for_depth = rng.spawn(3)
    hits = cast(scene, camera)
    linear = shaded(scene, camera, hits, lit(scene, camera, hits), for_texture)
    exact = hits.depth.astype(np.float32)
    return SyntheticFrame(
        rgb=developed(linear, for_picture, noise),
        depth_m=measured_depth(hits.depth, camera, for_depth) if noise else exact.copy(),
        depth_exact_m=exact,
        normal=normals_in_camera(scene, hits),
        label=labels(scene, hits),
    )


def check_number(name: str, value: int, least: int) -> None:
    """Raise NimprepError unless a whole number is at least this large."""
    if operator.index(value) < least:
        raise NimprepError(f"synthetic {name}: expected a whole number >= {least}, found {value}")
