"""Colour: reflectance, light, haze and sky, as a small camera would record them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.synthetic.raycast import NOTHING, Hits
from nimprep.synthetic.scene import Light, Scene
from nimprep.synthetic.shapes import Mask
from nimprep.synthetic.texture import Float32, float32_from, noise_tile, painted, sampled

HAZE_M = 90.0
"""At this distance half of the colour is the horizon's."""

SHOT_NOISE = 0.010
"""Standard deviation of the image noise, of full scale."""


def shaded(
    scene: Scene,
    camera: Camera,
    hits: Hits,
    lit: Mask,
    rng: np.random.Generator,
) -> Float32:
    """Return the linear light at each pixel, (H, W, 3) float32, about 0..1."""
    tile = noise_tile(rng)
    image = np.empty((camera.height * camera.width, 3), dtype=np.float32)
    sky = np.flatnonzero(hits.owner == NOTHING)
    image[sky] = _sky(scene.light, tile, hits, sky)
    horizon = float32_from(scene.light.horizon)
    light = _light(scene.light, hits, lit)
    for surface, seen in zip(scene.surfaces, hits.pixels, strict=True):
        a, b = (np.take(coordinate, seen).astype(np.float32) for coordinate in hits.texture)
        depth = np.take(hits.depth, seen).astype(np.float32)
        colour = painted(surface.finish, tile, a, b, depth / np.float32(camera.fx)) * light[seen]
        far = depth * depth
        haze = (far / (far + np.float32(HAZE_M**2)))[:, None]
        image[seen] = colour + haze * (horizon - colour)
    return image.reshape(*camera.shape, 3)


def developed(linear: Float32, rng: np.random.Generator, noise: bool) -> npt.NDArray[np.uint8]:
    """Return the 8-bit picture: exposure, gamma 2, a lens's blur, and noise if asked for."""
    gain = np.float32(rng.uniform(0.85, 1.25))
    encoded = np.sqrt(np.clip(linear * gain, 0, 1))
    if noise:
        # The sum of four bytes is near enough to a normal variate, and the same everywhere.
        dice = rng.integers(0, 256, (4, *linear.shape), dtype=np.uint8).sum(axis=0, dtype=np.int16)
        deviation = np.float32(SHOT_NOISE / np.sqrt(4 * (256**2 - 1) / 12))
        encoded += (dice - 510).astype(np.float32) * deviation
    blurred = _blurred(_blurred(encoded).transpose(1, 0, 2)).transpose(1, 0, 2)
    picture: npt.NDArray[np.uint8] = np.rint(np.clip(blurred, 0, 1) * 255).astype(np.uint8)
    return picture


def _light(light: Light, hits: Hits, lit: Mask) -> Float32:
    """Return the light that falls on each pixel's surface, (H * W, 3) float32: Lambert's law."""
    x, y, z = (component.ravel() for component in hits.normal)
    sx, sy, sz = light.to_sun
    sunny = (np.maximum(x * sx + y * sy + z * sz, 0) * lit.ravel()).astype(np.float32)
    open_sky = (0.65 - 0.35 * y).astype(np.float32)
    channels = zip(light.sun, light.ambient, strict=True)
    return np.stack(
        [np.float32(sun) * sunny + np.float32(ambient) * open_sky for sun, ambient in channels],
        axis=-1,
    )


def _sky(light: Light, tile: Float32, hits: Hits, sky: npt.NDArray[np.int64]) -> Float32:
    """Return the colour of the sky's pixels, (n, 3) float32: a gradient, clouds and far trees."""
    x, y, z = (np.take(component, sky).astype(np.float32) for component in hits.direction)
    flat: Float32 = np.sqrt(x * x + z * z)
    x, rise, z = np.divide(x, flat), np.divide(-y, flat), np.divide(z, flat)
    sharp = np.full_like(x, 1e-3)
    horizon, zenith = float32_from(light.horizon), float32_from(light.zenith)
    colour = horizon + np.clip(rise, 0, 1)[:, None] * (zenith - horizon)
    ceiling = np.maximum(rise + np.float32(0.15), np.float32(0.05))
    cloud = sampled(tile, np.divide(x, ceiling), np.divide(z, ceiling), sharp, 0.05)
    cover = np.clip(2 * cloud + np.float32(2 * light.clouds - 1), 0, 1)[:, None]
    colour = colour + cover * np.float32(0.6) * (np.float32(0.9) - colour)
    ragged = 1 + np.float32(0.7) * sampled(tile, x, np.zeros_like(x), sharp, 0.004)
    leaves = 1 + np.float32(0.5) * sampled(tile, x, rise, sharp, 0.003)
    trees = (rise < np.float32(light.skyline_height) * ragged)[:, None]
    result: Float32 = np.where(trees, float32_from(light.skyline) * leaves[:, None], colour)
    return result


def _blurred(image: Float32) -> Float32:
    """Return the image smoothed along its rows' axis by (1, 2, 1) / 4, the edges repeated."""
    padded = np.concatenate([image[:1], image, image[-1:]])
    smooth: Float32 = (padded[:-2] + padded[2:]) * np.float32(0.25) + image * np.float32(0.5)
    return smooth
