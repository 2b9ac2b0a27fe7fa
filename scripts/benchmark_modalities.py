"""Time disparity, transformed disparity and elevation of one frame, and say how flat its road is.

    python scripts/benchmark_modalities.py [--rounds 30]

A real GMRP frame of 1280x720 and KITTI road frames come from NIMPREP_REFERENCE_DATA (default
../shared/data from the project's root); a synthetic street of 1280x720 is always there. Times are
medians, in ms, on one thread and on all; the two fits run on the calling thread alone.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import nimprep
from nimprep import Camera
from nimprep.frame import VIRTUAL_BASELINE_M
from nimprep.parallel import available_cores
from nimprep.readers import open_reader
from nimprep.synthetic import render_frame

PROJECT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("NIMPREP_REFERENCE_DATA", PROJECT.parent / "shared" / "data"))


@dataclass(frozen=True)
class Case:
    """One frame: depth, camera, stereo baseline, and which pixels are labelled as road."""

    name: str
    depth_m: np.ndarray
    camera: Camera
    baseline_m: float
    road: np.ndarray


def cases() -> list[Case]:
    camera = Camera.from_fov(69.4, 1280, 720)
    frame = render_frame(0, 0, camera)
    found = [Case("synthetic", frame.depth_m, camera, VIRTUAL_BASELINE_M, frame.label == 1)]
    for folder in ("gmrp", "kitti_road"):
        if not (DATA / folder).is_dir():
            continue
        reader = open_reader(DATA / folder)
        for name in reader.ids:
            frame = reader.read(name, ("depth", "label"))
            known = np.isfinite(frame.baseline_m)
            baseline_m = frame.baseline_m if known else VIRTUAL_BASELINE_M
            if (frame.label == 1).any():
                road = frame.label == 1
                found.append(Case(name, frame.depth_m, frame.camera, baseline_m, road))
    return found


def median_ms(function: Callable[[], object], rounds: int) -> float:
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        function()
        times.append(1000 * (time.perf_counter() - start))
    return float(np.median(times[1:]))


def measure(case: Case, rounds: int) -> str:
    depth, camera = case.depth_m, case.camera
    disparity = nimprep.disparity_from_depth(depth, camera, case.baseline_m)
    profile = nimprep.estimate_road_profile(disparity)
    plane = nimprep.estimate_road_plane(depth, camera)
    row = f"{case.name[-18:]:18s} {camera.width:5d}x{camera.height:<4d}"
    for call in (
        lambda n: nimprep.disparity_from_depth(depth, camera, case.baseline_m, num_threads=n),
        lambda n: nimprep.transform_disparity(disparity, profile, num_threads=n),
        lambda n: nimprep.estimate_elevation(depth, camera, plane, num_threads=n),
    ):
        one, every = (median_ms(lambda n=n, call=call: call(n), rounds) for n in (1, None))
        row += f" {one:5.2f} {every:5.2f}"
    row += f" {median_ms(lambda: nimprep.estimate_road_profile(disparity), rounds):8.1f}"
    row += f" {median_ms(lambda: nimprep.estimate_road_plane(depth, camera), rounds):6.1f}"
    road = case.road & (depth > 0)
    transformed = np.abs(nimprep.transform_disparity(disparity, profile)[0][road])
    elevation = np.abs(nimprep.estimate_elevation(depth, camera, plane)[road])
    for values in (transformed, elevation):
        row += f" {np.median(values):7.3f} {np.percentile(values, 90):6.3f}"
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=30)
    options = parser.parse_args()
    print(
        f"ms on 1 thread and on {available_cores()}; |value| on the road: median, 90th percentile"
    )
    print(
        f"{'frame':18s} {'size':>10s} {'disparity':>11s} {'transform':>11s} {'elevation':>11s}",
        end="",
    )
    print(f" {'profile':>8s} {'plane':>6s} {'t-disp. px':>14s} {'elevation m':>14s}")
    for case in cases():
        print(measure(case, options.rounds), flush=True)


if __name__ == "__main__":
    main()
