"""Vectors, rays and the frame that the scenes are built in.

Scene frame: the camera at the origin, x right across the road, y down along the road's normal,
z ahead along the road, metres. Only ``+ - * /`` and ``sqrt`` touch arrays: IEEE 754 rounds these
alike on every machine, while vectorised sines and powers may differ in their last bit.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera

Array: TypeAlias = npt.NDArray[np.float64]
Mask: TypeAlias = npt.NDArray[np.bool_]
Vector: TypeAlias = tuple[float, float, float]
Rotation: TypeAlias = tuple[Vector, Vector, Vector]
Points: TypeAlias = tuple[Array, Array, Array]
"""x, y and z of many points or directions, each an array of one shape."""
Window: TypeAlias = tuple[slice, slice]

NEAR_M = 0.05
"""Nothing is seen nearer than this."""


def rotation_from_angles(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Rotation:
    """Return the rotation from the camera frame to the scene frame.

    Roll turns about the optical axis, then pitch lowers the view (positive looks down), then yaw
    turns it to the right.
    """
    cy, sy = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    cp, sp = math.cos(math.radians(pitch_deg)), math.sin(math.radians(pitch_deg))
    cr, sr = math.cos(math.radians(roll_deg)), math.sin(math.radians(roll_deg))
    return (
        (cy * cr - sy * sp * sr, -cy * sr - sy * sp * cr, sy * cp),
        (cp * sr, cp * cr, sp),
        (-sy * cr - cy * sp * sr, sy * sr - cy * sp * cr, cy * cp),
    )


def points_from_vector(vector: Vector) -> Points:
    """Return a vector as points that broadcast against any others."""
    x, y, z = (np.asarray(component, dtype=np.float64) for component in vector)
    return x, y, z


def dot(a: Vector, b: Vector) -> float:
    """Return the inner product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def unit(vector: Vector) -> Vector:
    """Return the vector of length 1 in this direction."""
    length = math.sqrt(dot(vector, vector))
    return vector[0] / length, vector[1] / length, vector[2] / length


def transposed(rotation: Rotation) -> Rotation:
    """Return the inverse rotation."""
    x, y, z = rotation
    return (x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])


def rotate(rotation: Rotation, points: Points) -> Points:
    """Return the points turned by a rotation."""
    x, y, z = (row[0] * points[0] + row[1] * points[1] + row[2] * points[2] for row in rotation)
    return x, y, z


def normalized(points: Points) -> Points:
    """Return directions scaled to length 1."""
    x, y, z = points
    length = np.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


def view_directions(camera: Camera, rotation: Rotation) -> Points:
    """Return each pixel's viewing direction in the scene frame, three (H, W) arrays.

    Their length makes the camera's own z component 1, so that the parameter of a hit along the ray
    is the hit's z-depth.
    """
    x = (np.arange(camera.width, dtype=np.float64) - camera.cx) / camera.fx
    y = (np.arange(camera.height, dtype=np.float64)[:, None] - camera.cy) / camera.fy
    rows = [row[0] * x + (row[1] * y + row[2]) for row in rotation]
    return rows[0], rows[1], rows[2]


def window_of(camera: Camera, rotation: Rotation, corners: list[Vector]) -> Window | None:
    """Return the part of the image that the convex hull of some points can touch.

    None where it lies outside. A hull that reaches behind the camera may touch all of the image.
    """
    inverse = transposed(rotation)
    seen = [(dot(inverse[0], c), dot(inverse[1], c), dot(inverse[2], c)) for c in corners]
    if all(z < NEAR_M for _, _, z in seen):
        return None
    if any(z < NEAR_M for _, _, z in seen):
        return slice(0, camera.height), slice(0, camera.width)
    u = [camera.fx * x / z + camera.cx for x, _, z in seen]
    v = [camera.fy * y / z + camera.cy for _, y, z in seen]
    left, right = max(math.floor(min(u)), 0), min(math.ceil(max(u)) + 1, camera.width)
    top, bottom = max(math.floor(min(v)), 0), min(math.ceil(max(v)) + 1, camera.height)
    if left >= right or top >= bottom:
        return None
    return slice(top, bottom), slice(left, right)
