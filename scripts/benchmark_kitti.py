"""Time the KITTI road tools: pack 290 frames, score 289, make depth from a scan and from stereo.

    python scripts/benchmark_kitti.py [--rounds 3]

Real frames come from NIMPREP_REFERENCE_DATA (default ../shared/data from the project's root); where
there is none, synthetic ones of the same sizes take their place. Packing and scoring are compared
with what they cannot do without, decoding the PNGs, on as many threads in the same run.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from nimprep.images import read_rgb
from nimprep.kitti import evaluate_predictions, pack_submission
from nimprep.kitti.calibration import Calibration, read_calibration
from nimprep.kitti.depth import millimetres_from_metres
from nimprep.kitti.images import png_bytes, read_confidence
from nimprep.kitti.lidar import project_lidar, read_velodyne
from nimprep.kitti.names import official_names
from nimprep.kitti.stereo import stereo_depth
from nimprep.parallel import available_cores, map_frames

PROJECT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("NIMPREP_REFERENCE_DATA", PROJECT.parent / "shared" / "data"))

CALIBRATION = """\
P2: 721.5377 0 609.5593 44.85728 0 721.5377 172.854 0.2163791 0 0 1 0.002745884
P3: 721.5377 0 609.5593 -339.5242 0 721.5377 172.854 2.199936 0 0 1 0.002729905
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27
Tr_cam_to_road: 1 0 0 0 0 1 0 -1.65 0 0 1 0
"""


def make_frames(folder: Path, real: bool) -> None:
    """Write 290 predictions, ground truths and calibrations, from the three real ones or noise."""
    for part in ("predictions", "gt", "calib"):
        (folder / part).mkdir()
    rng = np.random.default_rng(0)
    smooth = cv2.GaussianBlur(rng.integers(0, 256, (375, 1242)).astype(np.float32), (0, 0), 4)
    confidence = png_bytes(cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8))
    truth = np.zeros((375, 1242, 3), np.uint8)
    truth[..., 0], truth[200:, 300:900, 2] = 255, 255
    for name in official_names("road"):
        targets = {
            folder / "predictions" / name.png: confidence,
            folder / "gt" / name.png: png_bytes(truth) if not real else b"",
            folder / "calib" / f"{name.frame}.txt": CALIBRATION.encode(),
        }
        if real:
            training = DATA / "kitti_road" / "training"
            source = f"{name.category}_road_000000.png"
            calib = training / "calib" / f"{name.category}_000000.txt"
            files = (
                DATA / "kitti_road_golden" / "perspective" / source,
                training / "gt_image_2" / source,
                calib,
            )
            targets = dict(zip(targets, (f.read_bytes() for f in files), strict=True))
        for path, data in targets.items():
            path.write_bytes(data)


def stereo_frame(real: bool) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8], Calibration]:
    """Return a stereo pair and its calibration."""
    if real:
        training = DATA / "kitti_road" / "training"
        left, right = (read_rgb(training / f"image_{i}" / "um_000000.png") for i in (2, 3))
        return left, right, read_calibration(training / "calib" / "um_000000.txt")
    wide = np.random.default_rng(0).integers(0, 256, (375, 1272, 3), dtype=np.uint8)
    return wide[:, :1242].copy(), wide[:, 30:].copy(), synthetic_calibration()


def synthetic_calibration() -> Calibration:
    """Return `CALIBRATION`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "um_000000.txt"
        path.write_text(CALIBRATION)
        return read_calibration(path)


def lidar_frame(real: bool) -> tuple[Callable[[], npt.NDArray[np.float32]], Calibration]:
    """Return what reads a scan, and its calibration."""
    if real:
        folder = DATA / "kitti_lidar"
        scan = folder / "velodyne" / "000000.bin"
        return lambda: read_velodyne(scan), read_calibration(folder / "calib" / "000000.txt")
    rng = np.random.default_rng(0)
    points = rng.uniform((-60, -40, -1.7, 0), (60, 40, 1, 1), (115_000, 4)).astype(np.float32)
    return lambda: points, synthetic_calibration()


def timed(work: Callable[[], object]) -> float:
    """Return the seconds that one call takes."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def rounds_of(rounds: int, *works: Callable[[], object]) -> list[float]:
    """Time works in turns, so that a slow moment hits all of them; return each one's median."""
    times = [[timed(work) for work in works] for _ in range(rounds)]
    return [statistics.median(column) for column in zip(*times, strict=True)]


def benchmark_folders(folder: Path, rounds: int) -> list[tuple[str, float, str]]:
    """Time packing and scoring 290 frames against decoding their PNGs."""
    predictions, truths, calib = (folder / part for part in ("predictions", "gt", "calib"))
    files = sorted(predictions.iterdir())

    def decode() -> None:
        for _ in map_frames("decode", read_confidence, files):
            pass

    def pack() -> None:
        pack_submission(predictions, folder / "out.zip", calib, overwrite=True)

    def score() -> None:
        evaluate_predictions(predictions, truths, calib)

    floor, packing, scoring = rounds_of(rounds, decode, pack, score)
    return [
        ("decode 290 predictions", floor, ""),
        ("transform and pack 290 (goal 15 s)", packing, f"{packing / floor:.1f}x decoding"),
        ("transform and score 290", scoring, f"{scoring / floor:.1f}x decoding"),
    ]


def benchmark_depth(rounds: int) -> list[tuple[str, float, str]]:
    """Time depth of one frame on one thread."""
    from nimprep.derive.completion import fill_depth

    cv2.setNumThreads(1)
    left, right, pair_calibration = stereo_frame((DATA / "kitti_road").is_dir())
    read_scan, scan_calibration = lidar_frame((DATA / "kitti_lidar").is_dir())

    def project() -> npt.NDArray[np.float32]:
        return project_lidar(read_scan(), scan_calibration, 370, 1224)

    def densify() -> None:
        millimetres_from_metres(fill_depth(project(), method="linear", num_threads=1)[0])

    def match() -> npt.NDArray[np.float32]:
        return stereo_depth(left, right, pair_calibration)

    def dense_stereo() -> None:
        millimetres_from_metres(fill_depth(match(), method="linear", num_threads=1)[0])

    densify()
    names = ("LiDAR, sparse", "LiDAR, dense (goal 0.25 s)", "stereo, sparse", "stereo, dense")
    times = rounds_of(3 * rounds, project, densify, match, dense_stereo)
    return [(f"depth of one frame: {n}", t, "") for n, t in zip(names, times, strict=True)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    rounds = parser.parse_args().rounds
    real = (DATA / "kitti_road_golden").is_dir()
    folder = Path(tempfile.mkdtemp())
    try:
        make_frames(folder, real)
        rows = benchmark_folders(folder, rounds)
    finally:
        shutil.rmtree(folder)
    rows += benchmark_depth(rounds)
    print(f"{'real' if real else 'synthetic'} frames, {available_cores()} cores, {rounds} rounds")
    for name, seconds, note in rows:
        print(f"{name:44}{seconds:9.3f} s   {note}")


if __name__ == "__main__":
    main()
