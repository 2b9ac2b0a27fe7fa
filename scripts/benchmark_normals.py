"""Time normals of one 720p frame, and measure their errors on scenes with exact ones.

    python scripts/benchmark_normals.py [--rounds N] [--skip-errors]

Side by side: nimprep, its peers and the streaming bound; errors by scripts/normals_errors.py.

The frame is GMRP's of the reference data (folder from NIMPREP_REFERENCE_DATA, else ../shared/data
beside the project) or, without it, a synthetic one. A peer that is not installed is named as such;
`pip install "nimprep[bench]"` brings them. Each time is the best of interleaved rounds, the thread
count really set for each column. Every row takes float32 depth and leaves normals in an array that
is there already where the peer can, unless its name says otherwise. The real frame is noisy: how
long nim-edge takes where it finds nothing to smooth is measured on a synthetic frame.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from normals_errors import print_errors
from normals_peers import PEERS
from numba import float32, int64, njit, void

from nimprep import Camera, estimate_normals
from nimprep.camera import D415_HORIZONTAL_FOV_DEG
from nimprep.parallel import available_cores, run_blocks
from nimprep.synthetic import render_frame

Run = Callable[[], np.ndarray]

HEIGHT, WIDTH = 720, 1280
BLOCK_ROWS = 24
SECONDS_PER_ROW = 4.0


CLEAN = "nimprep nim-edge, frame without noise"


def reference_data() -> Path:
    """Return the folder of real frames, which may not be there."""
    here = Path(__file__).resolve().parent.parent
    return Path(os.environ.get("NIMPREP_REFERENCE_DATA", here.parent / "shared" / "data"))


def load_frame(data: Path) -> tuple[np.ndarray, str]:
    """Return (720, 1280) float32 metres, 0 = none, and where they come from."""
    path = data / "gmrp" / "depth_u16" / "000001.png"
    if path.is_file():
        raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        return np.where(raw == 65535, 0, raw) / np.float32(1000), "GMRP 000001"
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    depth = 400 / (v + 100) + 0.2 * np.sin(u / 40)
    depth[np.random.default_rng(0).random(depth.shape) < 0.2] = 0
    return (np.round(depth * 1000) / 1000).astype(np.float32), "synthetic"


@njit(void(float32[:, ::1], int64, int64, float32[:, :, ::1]), nogil=True, error_model="numpy")
def _stream(depth, row_start, row_stop, out):
    for v in range(row_start, row_stop):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            out[v, u, 0] = z
            out[v, u, 1] = z
            out[v, u, 2] = z


@njit(void(float32[:, ::1], int64, int64, float32[:, :, ::1]), nogil=True, error_model="numpy")
def _stream_vectorised(depth, row_start, row_stop, out):
    width = depth.shape[1]
    for v in range(row_start, row_stop):
        row, target = depth[v], out[v].reshape(3 * width)
        for u in range(width):
            z = row[u]
            target[3 * u] = z
            target[3 * u + 1] = z
            target[3 * u + 2] = z


def own_rows(depth: np.ndarray, clean: np.ndarray, camera: Camera, threads: int) -> dict[str, Run]:
    """Return nimprep's rows and the streaming bound, on this many threads."""
    out = np.zeros((*depth.shape, 3), np.float32)
    height = depth.shape[0]

    def bound(stream: Callable[..., None]) -> Run:
        def block(i: int) -> None:
            stream(depth, i * BLOCK_ROWS, min((i + 1) * BLOCK_ROWS, height), out)

        def run() -> np.ndarray:
            run_blocks(block, -(-height // BLOCK_ROWS), threads)
            return out

        return run

    def nim(depth: np.ndarray = depth, **options: object) -> Run:
        return lambda: estimate_normals(depth, camera, num_threads=threads, **options)

    return {
        "nimprep nim": nim(out=out),
        "nimprep nim, new array each time": nim(),
        "nimprep nim, sign filter": nim(out=out, sign_filter=True),
        "nimprep nim-edge": nim(out=out, method="nim-edge"),
        CLEAN: nim(clean, out=out, method="nim-edge"),
        "streaming bound, plain loop": bound(_stream),
        "streaming bound, vectorised": bound(_stream_vectorised),
    }


def best_times(rows: dict[str, Run], rounds: int) -> dict[str, float]:
    """Return the best time of each row, ms; slow rows take part in fewer rounds."""
    times: dict[str, list[float]] = {name: [] for name in rows}
    for run in rows.values():
        run()
    for _ in range(rounds):
        for name, run in rows.items():
            # Three in a row, so that nobody pays for the caches the one before has filled.
            for _ in range(3):
                if sum(times[name]) > SECONDS_PER_ROW:
                    break
                start = time.perf_counter()
                run()
                times[name].append(time.perf_counter() - start)
    return {name: 1000 * min(taken) for name, taken in times.items()}


def angle_to(reference: np.ndarray, normals: np.ndarray) -> float:
    """Return the median angle between two fields of normals, degrees, either sign."""
    found = np.nan_to_num(normals[..., :3].astype(np.float64))
    both = (np.abs(reference).sum(-1) > 0) & (np.abs(found).sum(-1) > 0)
    across = np.linalg.norm(np.cross(found[both], reference[both]), axis=-1)
    along = np.abs(np.sum(found[both] * reference[both], axis=-1))
    return float(np.degrees(np.median(np.arctan2(across, along))))


def print_table(
    one: dict[str, float], every: dict[str, float], angles: dict[str, float], threads: int
) -> None:
    base = "nimprep nim"
    print(f"| | 1 thread, ms | ratio | {threads} threads, ms | ratio | median angle to nim |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    for name in one:
        ratios = one[name] / one[base], every[name] / every[base]
        angle = "" if "bound" in name or name == CLEAN else f"{angles[name]:.2f}°"
        print(
            f"| {name} | {one[name]:.2f} | {ratios[0]:.2f} "
            f"| {every[name]:.2f} | {ratios[1]:.2f} | {angle} |"
        )


def print_outcome(every: dict[str, float], peers: list[str]) -> None:
    nim = every["nimprep nim"]
    if peers:
        from_depth = [name for name in peers if "points given" not in name]
        for what, names in (("from depth", from_depth), ("of all", peers)):
            fastest = min(names, key=lambda name: every[name])
            print(f"fastest peer {what}: {fastest}, {every[fastest] / nim:.1f} times nim's time")
    for name in peers:
        if "torch" in name:
            print(f"{name}: {every[name] / nim:.0f} times nim's time")
    for name in ("nimprep nim-edge", CLEAN):
        versus = (
            f", 1/{every['d2nt v3'] / every[name]:.0f} of d2nt v3's" if "d2nt v3" in every else ""
        )
        print(f"{name}: {every[name] / nim:.2f} times nim's time{versus}")
    for name in (name for name in every if "bound" in name):
        print(f"nim reaches {every[name] / nim:.0%} of the {name}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--skip-errors", action="store_true", help="Measure time alone.")
    arguments = parser.parse_args()
    depth, source = load_frame(reference_data())
    camera = Camera.from_fov(D415_HORIZONTAL_FOV_DEG, WIDTH, HEIGHT)
    clean = render_frame(0, 0, camera, noise=False).depth_exact_m
    print(f"{source}, {WIDTH}x{HEIGHT}, {np.mean(depth == 0):.0%} without depth\n")
    reference = estimate_normals(depth, camera)
    columns, angles, missing = [], {}, []
    for threads in (1, available_cores()):
        rows = own_rows(depth, clean, camera, threads)
        peers = {}
        for prepare in PEERS:
            try:
                peers |= prepare(depth, camera, threads)
            except ImportError as error:
                missing.append(str(error.name))
        rows |= peers
        angles = {name: angle_to(reference, run()) for name, run in rows.items()}
        columns.append(best_times(rows, arguments.rounds))
    print_table(columns[0], columns[1], angles, available_cores())
    for name in sorted(set(missing)):
        print(f"{name}: not installed")
    print()
    print_outcome(columns[1], list(peers))
    if not arguments.skip_errors:
        print()
        print_errors(reference_data(), columns[1])


if __name__ == "__main__":
    main()
