"""Procedural surfaces: a periodic noise tile and the patterns drawn with it.

Colours are linear RGB reflectances in 0..1. All arrays are float32 over n points of a surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Float32: TypeAlias = npt.NDArray[np.float32]
Colour: TypeAlias = tuple[float, float, float]

TILE = 256
"""Side of the noise tile, texels; a power of two."""
FINE_TEXEL_M, COARSE_TEXEL_M = 0.004, 0.055
"""The tile is laid out at two scales: grain and patches."""


class Pattern(Enum):
    """What a surface looks like."""

    PLAIN = "one colour, hardly any grain"
    ROAD = "asphalt, with a dashed line in the accent colour along the middle"
    TILES = "square paving stones, joints in the accent colour"
    BRICKS = "running bond, joints in the accent colour"
    LEAVES = "grass and hedges: strong grain between both colours"
    BANDS = "bands of both colours"


@dataclass(frozen=True)
class Finish:
    """Describe a surface's look.

    Attributes
    ----------
    pattern : Pattern
        What is drawn.
    colour, accent : Colour
        Reflectances of the main and the second colour.
    scale_m : float
        Length of a stone, brick, dash or band, metres.
    """

    pattern: Pattern
    colour: Colour
    accent: Colour
    scale_m: float = 1.0


def float32_from(colour: Colour) -> Float32:
    """Return a colour as (3,) float32."""
    return np.array(colour, dtype=np.float32)


def noise_tile(rng: np.random.Generator) -> Float32:
    """Return a (TILE, TILE) float32 tile of fractal noise in -1..1 that repeats without a seam."""
    tile = np.zeros((TILE, TILE))
    cells = (1, 2, 4, 8, 16, 32)
    for cell in cells:
        lattice = rng.random((TILE // cell, TILE // cell)) * 2 - 1
        tile += _stretched(_stretched(lattice, cell).T, cell).T
    return (tile / len(cells) * 2).clip(-1, 1).astype(np.float32)


def smooth_noise(
    rng: np.random.Generator, shape: tuple[int, int], cell: tuple[int, int]
) -> npt.NDArray[np.float64]:
    """Return noise in -1..1 of this shape, linear between random values a cell apart."""
    rows, columns = (size // step + 2 for size, step in zip(shape, cell, strict=True))
    lattice = rng.random((rows, columns)) * 2 - 1
    wide = _stretched(_stretched(lattice, cell[0]).T, cell[1]).T
    return wide[: shape[0], : shape[1]]


def painted(finish: Finish, tile: Float32, a: Float32, b: Float32, footprint_m: Float32) -> Float32:
    """Return the reflectance of points, (n, 3) float32.

    Parameters
    ----------
    finish : Finish
        The surface's look.
    tile : (TILE, TILE) float32
        Noise.
    a, b : (n,) float32, metres
        Coordinates along the surface.
    footprint_m : (n,) float32, metres
        Size of a pixel there: detail smaller than it fades, as it does in a lens.
    """
    fine = sampled(tile, a, b, footprint_m, FINE_TEXEL_M)
    coarse = sampled(tile, b, a, footprint_m, COARSE_TEXEL_M)
    fine_gain, coarse_gain = _GAINS[finish.pattern]
    light = 1 + np.float32(fine_gain) * fine + np.float32(coarse_gain) * coarse
    share = _accent_share(finish, tile, a, b, footprint_m, fine + coarse)
    main, accent = float32_from(finish.colour), float32_from(finish.accent)
    mixed = main + share[:, None] * (accent - main)
    result: Float32 = np.maximum(mixed, 0) * np.maximum(light, np.float32(0.1))[:, None]
    return result


_GAINS = {
    Pattern.PLAIN: (0.06, 0.10),
    Pattern.ROAD: (0.45, 0.22),
    Pattern.TILES: (0.20, 0.15),
    Pattern.BRICKS: (0.25, 0.20),
    Pattern.LEAVES: (0.60, 0.35),
    Pattern.BANDS: (0.06, 0.10),
}
"""How strongly grain and patches change the brightness."""

_JOINT_M = np.float32(0.012)
_LINE_M = np.float32(0.12)
_ONE_LINE_M = np.float32(1e4)
"""Lines this far apart: only the one in the middle of the road is seen."""


def _accent_share(
    finish: Finish, tile: Float32, a: Float32, b: Float32, footprint_m: Float32, noise: Float32
) -> Float32:
    """Return how much of the accent colour is at each point, 0 none, 1 all."""
    scale_m = finish.scale_m
    share: Float32
    match finish.pattern:
        case Pattern.PLAIN:
            share = np.zeros_like(a)
        case Pattern.ROAD:
            line = _on_lines(a, _ONE_LINE_M, _LINE_M, footprint_m)
            share = line * (_fraction(b / np.float32(scale_m)) < 0.5)
        case Pattern.TILES:
            share = _masonry(tile, a, b, (scale_m, scale_m, 0.0), footprint_m)
        case Pattern.BRICKS:
            share = _masonry(tile, a, b, (scale_m, scale_m / 3, 0.5), footprint_m)
        case Pattern.LEAVES:
            share = np.clip(np.float32(0.5) + noise, 0, 1)
        case Pattern.BANDS:
            share = (_fraction(b / np.float32(2 * scale_m)) < 0.5).astype(np.float32)
    return share


def _masonry(
    tile: Float32, a: Float32, b: Float32, stone: tuple[float, float, float], footprint_m: Float32
) -> Float32:
    """Return the joints of stones, no two of which are quite alike.

    A stone is its length and height, metres, and the part of its length by which each row is
    shifted against the one before.
    """
    length, height, shift_m = (np.float32(x) for x in (stone[0], stone[1], stone[2] * stone[0]))
    row = np.floor(b / height)
    along = a + row * shift_m
    column = np.floor(along / length)
    i, j = (row * 37).astype(np.int32) & (TILE - 1), (column * 53).astype(np.int32) & (TILE - 1)
    joints = np.maximum(
        _on_lines(along, length, _JOINT_M, footprint_m),
        _on_lines(b, height, _JOINT_M, footprint_m),
    )
    result: Float32 = np.maximum(joints, np.float32(0.35) * tile[i, j])
    return result


def _on_lines(x: Float32, step: np.float32, width: np.float32, footprint_m: Float32) -> Float32:
    """Return how much of a pixel lies on lines of this width at the multiples of a step."""
    gap = np.abs(x - step * np.floor(x / step + np.float32(0.5)))
    half = np.maximum(width, footprint_m) / 2
    strength = np.minimum(width / footprint_m, 1)
    result: Float32 = strength * np.clip((half - gap) / (footprint_m / 2) + np.float32(0.5), 0, 1)
    return result


def _fraction(x: Float32) -> Float32:
    result: Float32 = x - np.floor(x)
    return result


def sampled(tile: Float32, a: Float32, b: Float32, footprint_m: Float32, texel_m: float) -> Float32:
    """Return the tile's value at points, bilinear, faded where a pixel spans many texels."""
    u, v = a / np.float32(texel_m), b / np.float32(texel_m)
    column, row = np.floor(u), np.floor(v)
    u, v = u - column, v - row
    i, j = row.astype(np.int32) & (TILE - 1), column.astype(np.int32) & (TILE - 1)
    below, right = (i + 1) & (TILE - 1), (j + 1) & (TILE - 1)
    flat = tile.ravel()
    i, below = i * TILE, below * TILE
    top = flat[i + j] + u * (flat[i + right] - flat[i + j])
    bottom = flat[below + j] + u * (flat[below + right] - flat[below + j])
    # Half of the tile's power lies in cells of 8 texels and more, which fade later.
    fade = np.minimum(np.float32(6 * texel_m) / footprint_m, 1)
    result: Float32 = (top + v * (bottom - top)) * fade
    return result


def _stretched(lattice: npt.NDArray[np.float64], cell: int) -> npt.NDArray[np.float64]:
    """Return rows a cell apart joined by straight lines, the last with the first."""
    share = (np.arange(cell) / cell)[None, :, None]
    following = np.roll(lattice, -1, axis=0)
    rows = lattice[:, None, :] + share * (following - lattice)[:, None, :]
    return rows.reshape(lattice.shape[0] * cell, lattice.shape[1])
