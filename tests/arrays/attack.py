"""Hand public functions depth, disparity and points of absurd sizes, and print what goes wrong.

python -m tests.arrays.attack

A process of its own: an index outside its array ends it. What is being tried is said on stderr
first. Every result must be finite, NaN where none is told so; the only errors are our own.
"""

from __future__ import annotations

import faulthandler
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from nimprep import Camera
from nimprep.arrays import LEAST_DEPTH_M
from nimprep.errors import NimprepError
from tests.arrays.takers import DISPARITY, TAKERS, Argument, Array, Taker, leaves
from tests.derive.roads import CAMERA, ROADS, plane_of, road_depth
from tests.derive.test_normals import measured

LEAST = np.float32(LEAST_DEPTH_M)
TINY = [1e-45, 1e-40, 1.1754944e-38, 1e-30, 1e-20, 1e-12, float(np.nextafter(LEAST, 0))]
LARGE = [1e4, 1e10, 1e20, 1e30, 1e38, 3.4028235e38]
ORDINARY = [float(LEAST), 1e-3, 0.05, 1.0, 100.0]
NONE = [0.0, -0.0, np.nan, -np.nan, np.inf, -np.inf]
VALUES = np.array([*TINY, *ORDINARY, *LARGE, *NONE], np.float32)

SHAPES = [(24, 32), (17, 41), (40, 33), (1, 1), (1, 9), (9, 1), (2, 2), (7, 7), (64, 3)]
NUMBERS = [(30, 31, 15.5, 11), (1e-3, 1e6, 1e6, -1e6), (1e6, 1e-3, -1e6, 1e6), (1e-3, 1e-3, 0, 0)]

rng = np.random.default_rng(1)


def beside_ordinary(value: np.float32, shape: tuple[int, int]) -> Iterator[Array]:
    """Return images of a value alone, at single pixels, in halves and here and there."""
    plain = (2 + rng.random(shape)).astype(np.float32)
    yield np.full(shape, value)
    for v, u in ((0, 0), (shape[0] // 2, shape[1] // 2), (-1, -1)):
        image = plain.copy()
        image[v, u] = value
        yield image
    for part in (np.s_[: shape[0] // 2], np.s_[:, shape[1] // 2 + 1 :], np.s_[::2, 1::2]):
        for base in (plain, np.ones(shape, np.float32)):
            image = base.copy()
            image[part] = value
            yield image
    yield np.where(rng.random(shape) < 0.2, value, plain)


def images() -> Iterator[Array]:
    for value in VALUES:
        yield from beside_ordinary(value, SHAPES[0])
    for shape in SHAPES:
        for _ in range(4):
            yield rng.choice(VALUES, shape)
            # A few of each, so that the median is a depth's.
            yield np.where(rng.random(shape) < 0.7, np.float32(1.5), rng.choice(VALUES, shape))
    depth = road_depth(plane_of(*ROADS["rolled"])).astype(np.float32)
    for road in (depth, DISPARITY):
        for value in VALUES:
            yield np.where(rng.random(CAMERA.shape) < 0.05, value, road)


def cameras(image: Array, number: int) -> Iterator[Camera]:
    """Return an ordinary camera, and in turn one of those at the ends of the ranges."""
    height, width = image.shape
    if image.shape == CAMERA.shape:
        yield CAMERA
        return
    for fx, fy, cx, cy in (NUMBERS[0], NUMBERS[1 + number % 3]):
        yield Camera(fx, fy, cx, cy, width=width, height=height)


def fitting(argument: Argument, name: str, attacked: str, image: Array) -> Any:
    """Return an argument of the attacked image's size, the attacked one as what it takes."""
    if name == attacked and argument.like == "points":
        return image.reshape(-1)[: image.size // 3 * 3].reshape(-1, 3)
    if name == attacked:
        signed = argument.like == "signed"
        # Differences have either sign.
        return np.where(rng.random(image.shape) < 0.5, -image, image) if signed else image
    if argument.array.shape[:2] != CAMERA.shape:
        return argument.array
    height, width = image.shape
    return argument.array[:height, :width]


def problem(taker: Taker, camera: Camera, arrays: dict[str, Any], name: str) -> str | None:
    """Return what is wrong with what a function makes of arrays; None = nothing."""
    try:
        result = leaves(taker.call(camera, **arrays))
    except NimprepError as error:
        return None if "expected" in str(error) else f"a message without what was expected: {error}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    for leaf in result:
        if leaf.dtype.kind == "f":
            nan_is_none = taker.absent is not None and np.isnan(taker.absent)
            if not (np.isfinite(leaf) | (np.isnan(leaf) & nan_is_none)).all():
                return "a result that is not finite"
    if taker.gives_depth and ((result[0] != 0) & (result[0] < LEAST)).any():
        return "a depth below the least"
    if taker.absent is not None:
        image = arrays[name]
        least = LEAST if taker.arguments[name].like == "depth" else 0
        some = (image >= least) & (image > 0) & np.isfinite(image)
        some = measured(some.astype(np.float32)) if taker.beside else some
        first = result[0]
        there = ~np.isnan(first) if np.isnan(taker.absent) else first != taker.absent
        there = there.any(axis=-1) if there.ndim == 3 else there
        if not np.array_equal(there, some):
            return "a result where there is no depth, or none where there is"
    return None


def main() -> None:
    warnings.simplefilter("error")
    faulthandler.enable()
    tried = 0
    for taker in TAKERS:
        for name, argument in taker.arguments.items():
            if not argument.like:
                continue
            print(f"trying {taker.name}, {name}", file=sys.stderr, flush=True)
            for number, image in enumerate(images()):
                for camera in cameras(image, number):
                    arrays = {
                        n: fitting(a, n, name, image.astype(np.float32))
                        for n, a in taker.arguments.items()
                    }
                    tried += 1
                    wrong = problem(taker, camera, arrays, name)
                    if wrong is not None:
                        print(f"{taker.name}, {name}, image {number}, {camera}: {wrong}")
    print(f"{tried} tried")


if __name__ == "__main__":
    main()
