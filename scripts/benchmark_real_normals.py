"""How well normals of real frames tell road from the rest: nimprep's and OpenCV's methods.

    python scripts/benchmark_real_normals.py [--data FOLDER] [--pairs N] [--skip-errors]

FOLDER holds kitti_road/ with training frames and their right images, and gmrp/, each in its own
layout; default: NIMPREP_REFERENCE_DATA, else ../shared/data. KITTI's depth is stereo's.

A road is a plane, so its normals should agree. Angle: the median angle of the road's normals to
their own median. AUC: how well that angle alone tells road from all else (KITTI) or from anomalies
(GMRP); 0.5 = not at all. Of LiDAR, one scan of kitti_lidar/ as measured and filled, the angle in
the middle of the lower quarter alone: no label says where the road is there. Then mean errors where
the truth is known (scripts/normals_errors.py), and times on the noisy frames in pairs: nim-edge's
by nim's, and what the estimate of noise takes, one thread each.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from normals_errors import print_errors
from normals_peers import opencv

from nimprep import Camera, estimate_normals
from nimprep.derive.completion import fill_depth
from nimprep.derive.method_choice import measure_noise, method_for
from nimprep.derive.methods import FixedMethod
from nimprep.derive.noise import estimate_noise
from nimprep.kitti.calibration import read_calibration
from nimprep.kitti.depth import frame_depth
from nimprep.kitti.images import read_ground_truth
from nimprep.kitti.layout import list_road_files
from nimprep.readers import open_reader


@dataclass(frozen=True)
class RealFrame:
    """Hold a frame's depth, which pixels are road, and which it is to be told from."""

    name: str
    depth_m: np.ndarray
    camera: Camera
    road: np.ndarray
    other: np.ndarray


def kitti_frames(root: Path) -> Iterator[RealFrame]:
    """Yield training frames that have a right image, with stereo depth."""
    for files in list_road_files(root):
        if files.split == "training" and files.right_image.is_file():
            depth_m = frame_depth(files, "stereo")
            truth = read_ground_truth(files.ground_truth("road"))
            camera = read_calibration(files.calibration).camera(*depth_m.shape)
            road = truth.evaluated & truth.positive
            other = truth.evaluated & ~truth.positive
            yield RealFrame(f"KITTI {files.name}, stereo", depth_m, camera, road, other)


def gmrp_frames(root: Path) -> Iterator[RealFrame]:
    """Yield labelled frames: 1 is drivable, 2 an anomaly."""
    reader = open_reader(root)
    for frame_id in reader.ids:
        frame = reader.read(frame_id)
        assert frame.depth_m is not None
        assert frame.label is not None
        name = f"GMRP {frame_id}"
        yield RealFrame(name, frame.depth_m, frame.camera, frame.label == 1, frame.label == 2)


def lidar_frames(root: Path) -> Iterator[RealFrame]:
    """Yield a scan as measured and filled; the middle of its lower quarter is taken for road."""
    for files in list_road_files(root):
        sparse = frame_depth(files, "lidar", sparse=True)
        height, width = sparse.shape
        camera = read_calibration(files.calibration).camera(height, width)
        road = np.zeros(sparse.shape, bool)
        road[3 * height // 4 :, width // 3 : 2 * width // 3] = True
        filled = {"as measured": sparse}
        filled |= {way: fill_depth(sparse, way)[0] for way in ("nearest", "linear")}
        for way, depth_m in filled.items():
            name = f"KITTI LiDAR {files.name}, {way}"
            yield RealFrame(name, depth_m, camera, road, np.zeros_like(road))


def agreement(normals: np.ndarray, frame: RealFrame) -> tuple[float, float]:
    """Return (AUC, median angle in degrees); normals of either sign, NaN or 0 = none.

    The AUC is NaN where there is nothing to tell the road from, the angle without any normal.
    """
    known = np.isfinite(normals).all(axis=-1) & (np.abs(normals).sum(axis=-1) > 0)
    v, u = np.indices(known.shape)
    camera = frame.camera
    rays = np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1
    )
    away = (normals * rays).sum(axis=-1, keepdims=True) > 0
    towards = np.where(away, -normals, normals)
    road, other = towards[frame.road & known], towards[frame.other & known]
    if not len(road):
        return float("nan"), float("nan")
    middle = np.median(road, axis=0)
    middle /= np.linalg.norm(middle)
    of_road, of_other = (
        np.degrees(np.arccos(np.clip(some @ middle, -1, 1))) for some in (road, other)
    )
    return _auc(of_road, of_other), float(np.median(of_road))


def _auc(low: np.ndarray, high: np.ndarray) -> float:
    """Return the share of pairs in which `low`'s is less; equal ones count half, none is NaN."""
    if not high.size:
        return float("nan")
    ranked = np.sort(low)
    below, up_to = (np.searchsorted(ranked, high, side) for side in ("left", "right"))
    return float((below + up_to).sum() / (2 * low.size * high.size))


def methods(frame: RealFrame) -> dict[str, Callable[[], np.ndarray]]:
    """Return every method's run on a frame, by name."""
    depth_m, camera = frame.depth_m, frame.camera
    runs: dict[str, Callable[[], np.ndarray]] = {
        "nim": lambda: estimate_normals(depth_m, camera),
        "nim-edge": lambda: estimate_normals(depth_m, camera, "nim-edge"),
    }
    try:
        peers = opencv(depth_m, camera, 1)
    except ImportError as error:
        print(f"without {error.name}")
        return runs
    given = {f"OpenCV {m}": f"OpenCV {m}, points given" for m in ("FALS", "SRI", "CROSS_PRODUCT")}
    given["OpenCV LINEMOD"] = "OpenCV LINEMOD"
    return {**runs, **{name: peers[run] for name, run in given.items()}}


def print_agreement(frame: RealFrame) -> None:
    """Print a frame's noise, which method suits that, and every method's figures."""
    noise = estimate_noise(frame.depth_m)
    chosen = method_for([measure_noise(frame.depth_m, frame.camera)])
    print(f"\n{frame.name}: noise of {noise.sigma:.2g} 1/m, alike over {noise.length:.1f} px")
    print(f"  auto chooses {chosen}")
    for name, run in methods(frame).items():
        normals = np.asarray(run())[..., :3]
        auc, angle = agreement(normals, frame)
        some = np.nan_to_num(normals[frame.depth_m > 0]).any(axis=-1).mean()
        told = "" if np.isnan(auc) else f"  AUC {auc:.3f}"
        print(f"  {name:22}{told}  angle {angle:5.2f} deg  normals where depth is: {some:.0%}")


def print_times(frame: RealFrame, pairs: int) -> None:
    """Print the median of nim-edge's time by nim's, taken in pairs, and the estimate's."""
    depth_m, camera = frame.depth_m, frame.camera
    out = np.empty((*depth_m.shape, 3), np.float32)

    def seconds(run: Callable[[], object]) -> float:
        start = time.perf_counter()
        run()
        return time.perf_counter() - start

    def normals(method: FixedMethod) -> Callable[[], object]:
        return lambda: estimate_normals(depth_m, camera, method, out=out, num_threads=1)

    runs = normals("nim"), normals("nim-edge"), lambda: estimate_noise(depth_m)
    taken = np.array([[seconds(run) for run in runs] for _ in range(pairs + 1)])[1:]
    ratio = np.median(taken[:, 1] / taken[:, 0])
    nim, edge, estimate = 1000 * np.median(taken, axis=0)
    print(
        f"  {frame.name:32} nim {nim:.1f} ms, nim-edge {edge:.1f} ms, "
        f"ratio {ratio:.2f}, of which the estimate {estimate:.1f} ms"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser.add_argument(
        "--data", type=Path, default=os.environ.get("NIMPREP_REFERENCE_DATA", default)
    )
    parser.add_argument("--pairs", type=int, default=21)
    parser.add_argument("--skip-errors", action="store_true")
    options = parser.parse_args()
    data = options.data
    noisy = [*kitti_frames(data / "kitti_road"), *gmrp_frames(data / "gmrp")]
    for frame in [*noisy, *lidar_frames(data / "kitti_lidar")]:
        print_agreement(frame)
    if not options.skip_errors:
        print("\nMean errors where the truth is known, degrees:\n")
        print_errors(data, {})
    print("\nTimes, one thread:\n")
    for frame in noisy:
        print_times(frame, options.pairs)


if __name__ == "__main__":
    main()
