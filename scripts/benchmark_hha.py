"""Time HHA against a plain port of the reference, on the same frames in the same run.

    python scripts/benchmark_hha.py [--rounds 9] [--without-port]

The port stands for the Python HHA that the field uses: a stack of nine filtered images per window
size (SciPy's convolve2d), the plane solved image by image, ten rounds over copies of the normals,
one arc cosine per pixel in a Python loop. Real frames come from NIMPREP_REFERENCE_DATA (default
../shared/data from the project's root); where there is none, a synthetic room takes their place.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.signal import convolve2d

from nimprep.camera import Camera
from nimprep.derive.hha import encode_hha
from nimprep.parallel import available_cores

PROJECT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("NIMPREP_REFERENCE_DATA", PROJECT.parent / "shared" / "data"))


@dataclass(frozen=True)
class Case:
    """One frame: depth in double metres, as the port takes it, and in float32."""

    name: str
    exact_m: np.ndarray
    missing: np.ndarray
    camera: Camera

    @property
    def depth_m(self) -> np.ndarray:
        return self.exact_m.astype(np.float32)


def points(depth_m: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    z = depth_m * 100
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return (u - camera.cx) * z / camera.fx, (v - camera.cy) * z / camera.fy, z


def window_sum(image: np.ndarray, radius: int) -> np.ndarray:
    box = np.ones((2 * radius + 1, 2 * radius + 1))
    # Half a turn before and after: the port filters, and filters by turning a convolution.
    return np.rot90(convolve2d(np.rot90(image, 2), box, mode="same"), 2)


def port_normals(case: Case, radius: int) -> np.ndarray:
    xyz = np.stack(points(case.exact_m * 100 / 100, case.camera), axis=-1)
    x, y, z = (np.where(case.missing, np.nan, xyz[..., i]) for i in range(3))
    xz, yz, one = x / z, y / z, np.where(np.isnan(z), np.nan, 1.0)
    terms = [xz * xz, xz * yz, xz, yz * yz, yz, one, x / (z * z), y / (z * z), 1 / z]
    stack = np.stack([window_sum(np.nan_to_num(term, nan=0.0), radius) for term in terms], axis=-1)
    a, b, c, d, e, f, p, q, r = np.moveaxis(stack, -1, 0)
    adjugate = [d * f - e * e, -b * f + c * e, b * e - c * d]
    adjugate += [a * f - c * c, -a * e + b * c, a * d - b * b]
    i, j, k, m, n, o = adjugate
    normal = np.stack(
        [i * p + j * q + k * r, j * p + m * q + n * r, k * p + n * q + o * r], axis=-1
    )
    normal = normal / np.sqrt(np.sum(normal * normal, axis=2))[..., None]
    normal = normal * np.where(normal[..., 2] < 0, -1.0, 1.0)[..., None]
    return normal * np.where(np.sum(normal * xyz, axis=2) < 0, -1.0, 1.0)[..., None]


def port_gravity(normals: np.ndarray) -> np.ndarray:
    columns = normals.reshape(-1, 3).T
    columns = columns[:, ~np.isnan(columns[0])]
    gravity = np.array([0.0, 1.0, 0.0])
    for angle in np.radians([45] * 5 + [15] * 5):
        cosine = np.abs(gravity @ columns)
        floor, wall = columns[:, cosine > np.cos(angle)], columns[:, cosine < np.sin(angle)]
        values, vectors = np.linalg.eig(wall @ wall.T - floor @ floor.T)
        vector = vectors[:, np.argmin(values)]
        gravity = vector * np.sign(vector @ gravity)
    return gravity


def port_hha(case: Case) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        normals = port_normals(case, 3)
        gravity = port_gravity(port_normals(case, 10))
    xyz = np.stack(points(case.exact_m, case.camera), axis=-1)
    axis = np.cross([0.0, 1.0, 0.0], gravity)
    axis /= np.linalg.norm(axis)
    angle = math.acos(gravity[1])
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation = np.eye(3) + math.sin(angle) * skew + (1 - math.cos(angle)) * skew @ skew
    if math.degrees(angle) <= 0.1:
        rotation = np.eye(3)
    height = -(xyz.reshape(-1, 3) @ rotation)[:, 1].reshape(xyz.shape[:2])
    lowest = np.percentile(height, 0)
    height -= -130 if lowest > -90 else lowest
    cosine = np.clip(np.sum(normals * gravity, axis=2), -1, 1)
    angles = np.array([math.degrees(math.acos(x)) for x in cosine.flatten()]).reshape(height.shape)
    angles[np.isnan(angles)] = 180
    channels = [31000 / np.maximum(xyz[..., 2], 100), height, angles + 38]
    return np.minimum(np.rint(np.stack(channels, axis=-1)), 255).astype(np.uint8)


def synthetic_room(height: int, width: int) -> Case:
    camera = Camera.from_fov(60, width, height)
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    down = math.cos(0.2) * y + math.sin(0.2)
    ahead = math.cos(0.2) - math.sin(0.2) * y
    with np.errstate(divide="ignore"):
        surfaces = [np.where(down > 0, 1.5 / down, np.inf), 4 / ahead, 2 / np.abs(x)]
    noise = np.random.default_rng(0).normal(1, 0.002, x.shape)
    depth = np.rint(np.min(surfaces, axis=0) * noise * 1000) / 1000
    return Case(f"room {width}x{height}", depth, np.zeros(depth.shape, bool), camera)


def cases() -> list[Case]:
    small, large = synthetic_room(480, 640), synthetic_room(720, 1280)
    folder = DATA / "nyu_hha"
    if folder.is_dir():
        numbers = json.loads((folder / "camera.json").read_text())
        depth = cv2.imread(str(folder / "depth_filled.png"), cv2.IMREAD_UNCHANGED) / 10000
        raw = cv2.imread(str(folder / "depth_raw.png"), cv2.IMREAD_UNCHANGED)
        center = numbers["cx"] - 1, numbers["cy"] - 1
        camera = Camera(numbers["fx"], numbers["fy"], *center, 640, 480)
        small = Case("NYUv2 640x480", depth, np.zeros(depth.shape, bool), camera)
        masked = Case("NYUv2, missing", depth, raw == 0, camera)
    else:
        masked = Case("room, missing", small.exact_m, small.exact_m > 3.5, small.camera)
    path = DATA / "gmrp" / "depth_u16" / "000001.png"
    if path.is_file():
        raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        depth = np.where(raw == 65535, 0, raw) / 1000
        camera = Camera.from_fov(69.4, 1280, 720)
        large = Case("GMRP 1280x720", depth, depth == 0, camera)
    return [small, masked, large]


def milliseconds(function: Callable[[], object]) -> float:
    start = time.perf_counter()
    function()
    return 1000 * (time.perf_counter() - start)


def measure(case: Case, rounds: int, with_port: bool) -> str:
    missing = case.missing if case.missing.any() else None
    depth_m = case.depth_m

    def encode(threads: int | None) -> np.ndarray:
        return encode_hha(depth_m, case.camera, missing, num_threads=threads)

    ours = encode(None)
    times = np.array(
        [[milliseconds(lambda n=n: encode(n)) for n in (1, None)] for _ in range(rounds)]
    )
    one, every = np.median(times, axis=0)
    row = f"{case.name:16s} {one:9.2f} ms {every:9.2f} ms"
    if with_port:
        found: list[np.ndarray] = []
        port = min(milliseconds(lambda: found.append(port_hha(case))) for _ in range(2))
        difference = np.abs(found[0].astype(int) - ours).max(axis=-1)[case.exact_m > 0]
        shares = [100 * np.mean(difference <= level) for level in (0, 1)]
        row += f" {port:9.0f} ms {port / one:7.0f}x {port / every:7.0f}x"
        row += f" {shares[0]:10.4f} % {shares[1]:10.4f} %"
    return row


MEMORY = """
import resource, numpy as np
from pathlib import Path
from nimprep.camera import Camera
from nimprep.derive.hha import encode_hha
def frame(height, width):
    depth = 1 + np.random.default_rng(0).random((height, width), dtype=np.float32)
    return depth, Camera.from_fov(60, width, height)
encode_hha(*frame(64, 64))
depth, camera = frame(4320, 7680)
before = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
encode_hha(depth, camera)
peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print((peak - before) / depth.size)
"""


def memory_per_pixel() -> float:
    """Return the bytes per pixel by which a fresh process grows at its peak, with the output."""
    command = [sys.executable, "-c", MEMORY]
    return float(subprocess.run(command, check=True, capture_output=True, cwd=PROJECT).stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--without-port", action="store_true")
    options = parser.parse_args()
    print(f"{'frame':16s} {'1 thread':>12s} {f'{available_cores()} threads':>12s}", end="")
    print(f" {'plain port':>12s} {'ratio':>8s} {'ratio':>8s} {'equal':>12s} {'within 1':>12s}")
    for case in cases():
        print(measure(case, options.rounds, not options.without_port), flush=True)
    if Path("/proc/self/statm").is_file():
        print(f"memory beyond the input: {memory_per_pixel():.0f} bytes a pixel")


if __name__ == "__main__":
    main()
