"""What a stereo camera of the RealSense D415's kind makes of the exact depth.

The numbers are those of its matcher, which works on images 1280 pixels wide whatever the size
asked for; they were set beside a real frame of that camera.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.synthetic.shapes import Array, Mask
from nimprep.synthetic.texture import smooth_noise

BASELINE_M = 0.055
"""Distance between the D415's two infrared cameras (datasheet)."""
MATCHER_WIDTH = 1280
DISPARITY_SIGMA_PX = 0.2
"""Standard deviation of the disparity, pixels of the matcher's image."""
DISPARITY_STEP_PX = 1 / 32
"""Disparities come in these steps: 2.4 mm apart at 2 m, 39 mm at 8 m, as in real frames."""
WINDOW_PX = 11
"""The matching window: errors of neighbours closer than this are much alike."""
PIXEL_SHARE = 0.04
"""Part of the standard deviation that differs from pixel to pixel."""
RANGE_M = (0.3, 20.0)
"""Nothing is measured nearer or farther."""


def measured_depth(
    depth_m: Array, camera: Camera, rng: np.random.Generator
) -> npt.NDArray[np.float32]:
    """Return exact depth as a stereo camera would deliver it.

    Parameters
    ----------
    depth_m : (H, W) float64, metres
        Exact z-depth; 0 = the sky.
    camera : Camera
        The camera, taken as the stereo pair's left one.
    rng : numpy.random.Generator
        Source of the errors.

    Returns
    -------
    (H, W) float32, metres
        Whole millimetres; 0 = no depth: out of range, seen by the left camera only (left of
        whatever is nearer, and the image's left side), or by chance, in blobs, more often far away.

    Notes
    -----
    Depth is Z = f * b / d, with the disparity's error of one standard deviation everywhere, so
    that depth's own grows with the square of the distance: sigma_Z = Z**2 / (f * b) * sigma_d.
    """
    seen = (depth_m >= RANGE_M[0]) & (depth_m <= RANGE_M[1])
    reach = focal_baseline(camera)
    disparity = reach / np.where(seen, depth_m, np.inf)
    seen &= ~_hidden_from_the_right(disparity, camera) & ~_dropout(depth_m, camera, rng)
    error = _correlated_noise(rng, camera) * DISPARITY_SIGMA_PX
    steps = np.rint((disparity + error) / DISPARITY_STEP_PX)
    seen &= steps > 0
    millimetres = np.rint(reach / (np.where(seen, steps, np.inf) * DISPARITY_STEP_PX) * 1000)
    return millimetres.astype(np.float32) / np.float32(1000)


def focal_baseline(camera: Camera) -> float:
    """Return the matcher's focal length times its baseline, pixels times metres."""
    return camera.fx * MATCHER_WIDTH / camera.width * BASELINE_M


def _hidden_from_the_right(disparity: Array, camera: Camera) -> Mask:
    """Tell what the right camera does not see, outside its image or behind something nearer.

    Pixel u of the left image lands on u - d of the right one. Something that stands farther right
    and lands on the same place or beyond is in front of it.
    """
    scale = camera.width / MATCHER_WIDTH
    landing = np.arange(camera.width) - disparity * scale
    nearest = np.minimum.accumulate(landing[:, ::-1], axis=1)[:, ::-1]
    farther_right = np.concatenate([nearest[:, 1:], np.full((camera.height, 1), np.inf)], axis=1)
    margin = max(1, round(WINDOW_PX / 2 * scale))
    hidden: Mask = (farther_right <= landing) | (landing < margin)
    return hidden


def _dropout(depth_m: Array, camera: Camera, rng: np.random.Generator) -> Mask:
    """Tell where the matcher finds nothing: flat blobs, more of them with the distance."""
    unit = camera.width / MATCHER_WIDTH
    cell = max(2, round(12 * unit)), max(2, round(36 * unit))
    small = max(1, round(4 * unit)), max(1, round(10 * unit))
    blobs = smooth_noise(rng, camera.shape, cell) + 0.35 * smooth_noise(rng, camera.shape, small)
    dropped: Mask = blobs > 1.0 - 0.8 * np.minimum(depth_m / RANGE_M[1], 1)
    return dropped


def _correlated_noise(rng: np.random.Generator, camera: Camera) -> Array:
    """Return noise of mean 0 and standard deviation 1, smooth over the matching window.

    Sums of uniform variates, as the same everywhere as they are quick: two boxes one after the
    other, with a little that differs from pixel to pixel.
    """
    side = max(1, round(WINDOW_PX * camera.width / MATCHER_WIDTH))
    height, width = camera.height + 2 * (side - 1), camera.width + 2 * (side - 1)
    field = rng.random((height, width)) - 0.5
    for _ in range(2):
        field = _box_sums(_box_sums(field, side).T, side).T
    weights = np.convolve(np.ones(side), np.ones(side))
    field = field / (float(np.square(weights).sum()) * np.sqrt(1 / 12))
    fine = rng.random(camera.shape) - 0.5
    result: Array = PIXEL_SHARE * np.sqrt(12) * fine + np.sqrt(1 - PIXEL_SHARE**2) * field
    return result


def _box_sums(field: Array, side: int) -> Array:
    """Return the sums of so many consecutive rows."""
    rows = field.shape[0] - side + 1
    total = field[:rows].copy()
    for shift in range(1, side):
        total += field[shift : shift + rows]
    return total
