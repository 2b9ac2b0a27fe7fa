"""What each pixel's ray meets first: depth, normal, label, and whether the sun reaches it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.synthetic.scene import Scene
from nimprep.synthetic.shapes import (
    Array,
    Mask,
    Points,
    Vector,
    points_from_vector,
    rotate,
    transposed,
    view_directions,
    window_of,
)

FAR_M = 60.0
"""Scenes end here: below 65.535 m, the most that a depth image in millimetres holds."""

NOTHING = -1
_LOWEST_GROUND_M = 12.0


@dataclass(frozen=True)
class Hits:
    """Hold what the rays meet, per pixel.

    Attributes
    ----------
    direction : three (H, W) float64
        Viewing directions in the scene frame, with z-depth 1.
    depth : (H, W) float64, metres
        Exact z-depth; 0 = the sky.
    owner : (H, W) int16
        Index into the scene's surfaces; -1 = the sky.
    normal : three (H, W) float64
        Exact unit normals in the scene frame; (0, 0, 0) = the sky.
    texture : two (H, W) float64, metres
        Coordinates along the surface.
    pixels : tuple of (n,) int64
        For each surface of the scene, the flat indices of its pixels.
    """

    direction: Points
    depth: Array
    owner: npt.NDArray[np.int16]
    normal: Points
    texture: tuple[Array, Array]
    pixels: tuple[npt.NDArray[np.int64], ...]


def cast(scene: Scene, camera: Camera) -> Hits:
    """Return what the camera's rays meet first."""
    direction = view_directions(camera, scene.rotation)
    with np.errstate(divide="ignore", invalid="ignore"):  # a ray may run along a plane
        depth, owner = _nearest(scene, camera, direction)
    pixels = tuple(np.flatnonzero(owner == index) for index in range(len(scene.surfaces)))
    nx, ny, nz, a, b = (np.zeros(camera.shape) for _ in range(5))
    for surface, seen in zip(scene.surfaces, pixels, strict=True):
        t = depth.flat[seen]
        x, y, z = (np.take(component, seen) * t for component in direction)
        nx.flat[seen], ny.flat[seen], nz.flat[seen] = surface.normal((x, y, z))
        a.flat[seen], b.flat[seen] = surface.texture((x, y, z))
    return Hits(direction, depth, owner, (nx, ny, nz), (a, b), pixels)


def lit(scene: Scene, camera: Camera, hits: Hits) -> Mask:
    """Return (H, W) bool: no solid stands between the point and the sun."""
    result = np.ones(camera.shape, dtype=np.bool_)
    to_sun = points_from_vector(scene.light.to_sun)
    for solid in scene.solids:
        corners = solid.corners()
        window = window_of(camera, scene.rotation, corners + _shadow(corners, scene.light.to_sun))
        if window is None:
            continue
        depth = hits.depth[window]
        x, y, z = (component[window] * depth for component in hits.direction)
        with np.errstate(divide="ignore", invalid="ignore"):
            result[window] &= np.isinf(solid.distance(to_sun, (x, y, z)))
    return result


def normals_in_camera(scene: Scene, hits: Hits) -> npt.NDArray[np.float32]:
    """Return (H, W, 3) float32 unit normals in the camera frame, (0, 0, 0) = none."""
    in_camera = rotate(transposed(scene.rotation), hits.normal)
    return np.stack([component.astype(np.float32) for component in in_camera], axis=-1)


def labels(scene: Scene, hits: Hits) -> npt.NDArray[np.uint8]:
    """Return (H, W) uint8 labels; the sky is background."""
    table = np.array([*(surface.label for surface in scene.surfaces), 0], dtype=np.uint8)
    result: npt.NDArray[np.uint8] = table[hits.owner]
    return result


def _nearest(
    scene: Scene, camera: Camera, direction: Points
) -> tuple[Array, npt.NDArray[np.int16]]:
    depth = np.full(camera.shape, np.inf)
    owner = np.full(camera.shape, NOTHING, dtype=np.int16)
    for index, surface in enumerate(scene.surfaces):
        corners = surface.corners()
        everywhere = slice(0, camera.height), slice(0, camera.width)
        window = everywhere if corners is None else window_of(camera, scene.rotation, corners)
        if window is None:
            continue
        x, y, z = (component[window] for component in direction)
        t = surface.distance((x, y, z))
        closer = (t < depth[window]) & (t <= FAR_M)
        depth[window][closer] = t[closer]
        owner[window][closer] = index
    depth[owner == NOTHING] = 0
    return depth, owner


def _shadow(corners: list[Vector], to_sun: Vector) -> list[Vector]:
    """Return where the corners' shadows fall at the latest: on a plane below all ground."""
    reach = [max(_LOWEST_GROUND_M - y, 0.0) / -to_sun[1] for _, y, _ in corners]
    return [
        (x - r * to_sun[0], y - r * to_sun[1], z - r * to_sun[2])
        for (x, y, z), r in zip(corners, reach, strict=True)
    ]
