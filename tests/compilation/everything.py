"""Call every command and every public function once, and tell what was compiled meanwhile.

As a program, `python -m tests.compilation.everything WORLD`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numba.core import event

import nimprep
from nimprep.compilation.decorator import KERNELS
from nimprep.report.server import ViewServer
from nimprep.torch import StoreDataset, StoreLoader
from tests.cli.world import CALLS, run
from tests.fakes import SIZE

CAMERA = nimprep.Camera(30, 31, SIZE[1] / 2, SIZE[0] / 2, SIZE[1], SIZE[0])
PROFILE = nimprep.RoadProfile(1.0, (0.1, 0.01, 0.0), (0.0, float(SIZE[0])))
EVERY = ("rgb", "depth", "normal", "hha", "disparity", "transformed_disparity", "elevation")


def depth_m() -> npt.NDArray[np.float32]:
    """Return a road that rises to a wall, with noise and holes."""
    noise = np.random.default_rng(0).normal(0, 0.01, SIZE)
    depth = (45 / np.maximum(np.arange(SIZE[0]) - SIZE[0] / 2, 4)[:, None] + noise).astype("f4")
    depth[5:9, 7:12] = 0
    return depth


def disparity() -> npt.NDArray[np.float32]:
    """Return a road's, which grows from row to row."""
    rows = 1 + 0.3 * np.arange(SIZE[0], dtype=np.float32)
    return np.ascontiguousarray(np.broadcast_to(rows[:, None], SIZE))


def convert_and_read(world: Path) -> None:
    """Make and read every modality, in both data types of normals, and train from them."""
    for dtype in ("int8", "int16"):
        store = nimprep.convert(
            world / "raw",
            world / f"{dtype}.zarr",
            description=world / "raw.json",
            modalities=(*EVERY, "label"),
            normal_dtype=dtype,
            fill="nearest",
            normals="nim-edge",
        )
        for name in (*EVERY, "label"):
            assert getattr(store[0], "depth_m" if name == "depth" else name) is not None
    for normals in ("cached", "nim", "nim-edge"):
        for data in (
            StoreDataset(world / "int8.zarr", split=None, modalities=EVERY, normals=normals),
            StoreDataset(world / "int16.zarr", split=None, setup="nim-rgb+d", normals=normals),
        ):
            for _ in StoreLoader(data, batch_size=2):
                pass


FUNCTIONS: dict[str, Callable[[Path], Any]] = {
    "append_frames": lambda world: None,  # as the command
    "convert": convert_and_read,
    "depth_from_disparity": lambda world: nimprep.depth_from_disparity(disparity(), CAMERA),
    "disparity_from_depth": lambda world: nimprep.disparity_from_depth(depth_m(), CAMERA),
    "encode_hha": lambda world: [
        nimprep.encode_hha(depth_m(), CAMERA),
        nimprep.encode_hha(depth_m(), CAMERA, missing=depth_m() == 0, num_threads=1),
    ],
    "estimate_elevation": lambda world: nimprep.estimate_elevation(depth_m(), CAMERA),
    "estimate_gravity": lambda world: nimprep.estimate_gravity(depth_m(), CAMERA),
    "estimate_normals": lambda world: [
        nimprep.estimate_normals(depth_m(), CAMERA, sign_filter=True),
        nimprep.estimate_normals(depth_m(), CAMERA, method="nim-edge"),
        nimprep.estimate_normals(depth_m(), CAMERA, method="nim-edge", noise=0.01),
    ],
    "estimate_road_plane": lambda world: nimprep.estimate_road_plane(depth_m(), CAMERA),
    "estimate_road_profile": lambda world: nimprep.estimate_road_profile(disparity()),
    "fill_depth": lambda world: [
        nimprep.fill_depth(depth_m(), method, np.zeros((*SIZE, 3), np.uint8))
        for method in ("nearest", "linear", "colorization")
    ],
    "merge_stores": lambda world: None,  # as the command
    "open_store": lambda world: nimprep.open_store(world / "s.zarr")[0].normal,
    "restore_disparity": lambda world: nimprep.restore_disparity(disparity(), PROFILE),
    "road_plane": lambda world: nimprep.road_plane(np.eye(3, 4)),
    "transform_disparity": lambda world: nimprep.transform_disparity(disparity(), PROFILE),
    "warm_up": lambda world: nimprep.warm_up(),
}


def compiled_by_everything(world: Path) -> list[str]:
    """Call all of it, one after the other; return what was compiled, then or at an import."""
    ViewServer.run = lambda self: None  # type: ignore[method-assign]
    with event.install_recorder("numba:compile") as recorder:
        for function in FUNCTIONS.values():
            function(world)
        # Appending last: after it the store has the frames of the one that it is merged with.
        for name in sorted(CALLS, key="append".__eq__):
            for call in CALLS[name]:
                result = run(call.at(world, world / str(call).replace("/", "-")))
                assert result.exit_code == 0, (call, result.stderr, result.exception)
    late = {e.data["dispatcher"].py_func.__qualname__ for _, e in recorder.buffer}
    return sorted(late | {cache.name for cache in KERNELS.values() if cache.compiled})


if __name__ == "__main__":
    print(*compiled_by_everything(Path(sys.argv[1])))
