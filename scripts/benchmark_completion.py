"""Measure the filling of holes on real frames: what it gets wrong, and how long it takes.

    python scripts/benchmark_completion.py [--rounds 5] [--without-colorization]

Known pixels are hidden (a tenth of them one by one, or in squares of 25 pixels), the frame is
filled, and the filled depth is compared with the hidden one. Linear filling is timed against
SciPy's interpolation over the same points, nearest against SciPy's distance transform, in the same
run. Real frames come from NIMPREP_REFERENCE_DATA (default ../shared/data from the project's root);
where there is none, a synthetic road takes their place.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.ndimage import distance_transform_edt

from nimprep.derive.completion import FILL_METHODS, fill_depth
from nimprep.parallel import available_cores

PROJECT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("NIMPREP_REFERENCE_DATA", PROJECT.parent / "shared" / "data"))


@dataclass(frozen=True)
class Case:
    """One frame: depth in metres, 0 = none, its picture, and the side of the hidden squares."""

    name: str
    depth_m: np.ndarray
    rgb: np.ndarray
    sides: tuple[int, ...]


def depth_file(path: Path) -> np.ndarray:
    raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return np.where(raw == 65535, 0, raw) / np.float32(1000)


def picture_file(path: Path) -> np.ndarray:
    return np.ascontiguousarray(cv2.imread(str(path), cv2.IMREAD_COLOR)[..., ::-1])


def lidar_case() -> Case:
    """Project the scan of the object benchmark's frame; the nearest point wins a pixel."""
    folder = DATA / "kitti_lidar"
    lines = (folder / "calib" / "000000.txt").read_text().splitlines()
    table = {k: np.array(v.split(), float) for k, v in (ln.split(":") for ln in lines if ":" in ln)}
    rectify, to_camera = np.eye(4), np.eye(4)
    rectify[:3, :3] = table["R0_rect"].reshape(3, 3)
    to_camera[:3] = table["Tr_velo_to_cam"].reshape(3, 4)
    scan = np.fromfile(folder / "velodyne" / "000000.bin", np.float32).reshape(-1, 4).astype(float)
    scan[:, 3] = 1
    x, y, z = table["P2"].reshape(3, 4) @ rectify @ to_camera @ scan.T
    rgb = picture_file(folder / "image_2" / "000000.png")
    u, v = np.rint(x / z), np.rint(y / z)
    inside = (z > 0.5) & (u >= 0) & (u < rgb.shape[1]) & (v >= 0) & (v < rgb.shape[0])
    depth = np.full(rgb.shape[:2], np.inf, np.float32)
    np.minimum.at(depth, (v[inside].astype(int), u[inside].astype(int)), z[inside])
    return Case("KITTI LiDAR", np.where(np.isinf(depth), 0, depth), rgb, (1,))


def cases() -> list[Case]:
    if not DATA.is_dir():
        v, u = np.indices((375, 1242))
        depth = (1.65 * 720 / np.maximum(v - 170, 20)).astype(np.float32)
        rgb = np.stack([(8 * depth).astype(np.uint8)] * 3, axis=-1)
        return [Case("synthetic road", np.where(u % 7, depth, 0), rgb, (1, 25))]
    road = DATA / "kitti_road" / "training"
    return [
        Case(
            "GMRP",
            depth_file(DATA / "gmrp" / "depth_u16" / "000001.png"),
            picture_file(DATA / "gmrp" / "rgb" / "000001.png"),
            (1, 25),
        ),
        Case(
            "KITTI dense",
            depth_file(road / "depth_u16" / "uu_000000.png"),
            picture_file(road / "image_2" / "uu_000000.png"),
            (1, 25),
        ),
        lidar_case(),
    ]


def hide(depth_m: np.ndarray, side: int) -> np.ndarray:
    """Return where known pixels are hidden: about a tenth, in squares of this side."""
    height, width = depth_m.shape
    rng = np.random.default_rng(0)
    chosen = rng.random((-(-height // side), -(-width // side))) < 0.1
    return np.kron(chosen, np.ones((side, side), bool))[:height, :width] & (depth_m > 0)


def milliseconds(function: Callable[[], object]) -> float:
    start = time.perf_counter()
    function()
    return 1000 * (time.perf_counter() - start)


def scipy_linear(depth_m: np.ndarray) -> None:
    known = depth_m > 0
    interpolate = LinearNDInterpolator(np.argwhere(known), depth_m[known].astype(float))
    interpolate(*np.nonzero(~known))


def scipy_nearest(depth_m: np.ndarray) -> None:
    v, u = distance_transform_edt(depth_m == 0, return_distances=False, return_indices=True)
    _ = depth_m[v, u]


SCIPY = {"linear": scipy_linear, "nearest": scipy_nearest}


def measure(case: Case, side: int, method: str, rounds: int) -> str:
    hidden = hide(case.depth_m, side)
    sparse = np.where(hidden, 0, case.depth_m)
    filled, mask = fill_depth(sparse, method, case.rgb)
    scored = hidden & mask
    error = filled[scored] - case.depth_m[scored]
    relative = np.abs(error) / case.depth_m[scored]
    row = f"{case.name:12s} {side:3d} {method:13s} {100 * scored.sum() / hidden.sum():7.1f} %"
    row += f" {np.sqrt(np.mean(error**2)):8.3f} m {np.median(np.abs(error)):8.4f} m"
    row += f" {100 * np.mean(relative):7.2f} %"
    if method == "colorization":
        return row + f" {milliseconds(lambda: fill_depth(sparse, method, case.rgb)):21.1f} ms"
    times = [
        [milliseconds(lambda n=n: fill_depth(sparse, method, num_threads=n)) for n in (1, None)]
        for _ in range(rounds)
    ]
    one, every = np.median(times, axis=0)
    scipy = milliseconds(lambda: SCIPY[method](sparse))
    return row + f" {one:8.1f} ms {every:8.1f} ms {scipy:8.1f} ms {scipy / every:6.1f}x"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--without-colorization", action="store_true")
    options = parser.parse_args()
    print(
        f"{'frame':12s} {'px':>3s} {'method':13s} {'filled':>9s} {'RMSE':>10s} {'median':>10s}",
        end="",
    )
    print(f" {'relative':>9s} {'1 thread':>11s} {f'{available_cores()} threads':>11s}", end="")
    print(f" {'SciPy':>11s} {'ratio':>7s}")
    for case in cases():
        for side in case.sides:
            for method in FILL_METHODS:
                if method != "colorization" or not options.without_colorization:
                    print(measure(case, side, method, options.rounds), flush=True)


if __name__ == "__main__":
    main()
