"""How far normals are from exact ones, for scripts/benchmark_normals.py.

Clean scenes are two of Fan et al.'s ("Three-Filters-to-Normal", RA-L 2021; of the reference data,
left out where that is absent) and streets ray-cast by nimprep. Noisy ones are the streets with
depth rounded to millimetres; with independent errors of a tenth of a pixel of disparity and a
tenth of the pixels missing; and as a stereo camera sees them: errors alike over its matching
window, disparity in steps, holes. Both grow with the square of the distance. Errors are the mean
angle to the exact normal, either sign, over the pixels where depth is and the method gives one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from normals_peers import d2nt, kornia, opencv

from nimprep import Camera, estimate_normals
from nimprep.camera import D415_HORIZONTAL_FOV_DEG
from nimprep.synthetic import render_frame
from nimprep.synthetic.sensor import focal_baseline

Method = Callable[[np.ndarray, Camera], np.ndarray]

STREETS = 4
SIZE = 640, 480
EDGE_PX = 2
"""Pixels this close to a depth edge are at it."""
EDGE_STEP = 0.05
"""Neighbours whose depths differ by this share have an edge between them."""


@dataclass(frozen=True)
class Case:
    """Hold one depth image with its exact normals."""

    kind: str
    name: str
    depth: np.ndarray
    exact: np.ndarray
    camera: Camera


def reference_cases(data: Path) -> list[Case]:
    """Return the two scenes of the reference data; none where it is absent."""
    cases = []
    for name in ("android", "demo"):
        folder = data / "normals_3f2n" / name
        if not folder.is_dir():
            print(f"{name}: not at {folder}, left out\n")
            continue
        depth = np.fromfile(folder / "depth.bin", np.float32).reshape(480, 640)
        depth = np.where(depth == 1, np.float32(0), depth)
        fx, fy, cx, cy, _ = map(float, (folder / "params.txt").read_text().split())
        raw = cv2.imread(str(folder / "normal.png"), cv2.IMREAD_UNCHANGED)
        camera = Camera(fx, fy, cx - 1, cy - 1, 640, 480)
        cases.append(Case("clean", name, depth, 1 - raw[..., ::-1] / 32767.5, camera))
    return cases


def street_cases() -> list[Case]:
    """Return the streets, clean and with each kind of noise."""
    camera = Camera.from_fov(D415_HORIZONTAL_FOV_DEG, *SIZE)
    rng = np.random.default_rng(0)
    cases = []
    for i in range(STREETS):
        frame = render_frame(0, i, camera)
        exact = frame.depth_exact_m
        inverse = 1 / np.where(exact > 0, exact, np.inf)
        inverse = inverse + rng.normal(0, 0.1 / focal_baseline(camera), exact.shape)
        seen = (exact > 0) & (rng.random(exact.shape) > 0.1)
        depths = {
            "clean": exact,
            "mm": np.round(exact * 1000) / np.float32(1000),
            "independent": np.where(seen, 1 / np.maximum(inverse, 1e-3), 0).astype(np.float32),
            "stereo": np.where(exact > 0, frame.depth_m, np.float32(0)),
        }
        cases += [Case(kind, f"street {i}", d, frame.normal, camera) for kind, d in depths.items()]
    return cases


def methods() -> dict[str, Method]:
    """Return every method that can be had, by the name its time has."""

    def peer(prepare: Callable[..., dict], name: str) -> Method:
        return lambda depth, camera: prepare(depth, camera, 1)[name]()

    found: dict[str, Method] = {
        "nimprep nim": lambda depth, camera: estimate_normals(depth, camera),
        "nimprep nim-edge": lambda depth, camera: estimate_normals(depth, camera, "nim-edge"),
    }
    small, camera = np.ones((8, 8), np.float32), Camera(8, 8, 4, 4, 8, 8)
    for prepare in (opencv, kornia, d2nt):
        try:
            names = prepare(small, camera, 1)
        except ImportError:
            continue
        found |= {n: peer(prepare, n) for n in names if "points given" not in n}
    return found


def angles(found: np.ndarray, case: Case) -> np.ndarray:
    """Return the angle to the exact normal, degrees; NaN where either is missing."""
    found = np.asarray(found, np.float64)[..., :3]
    across = np.linalg.norm(np.cross(found, case.exact), axis=-1)
    along = np.abs(np.sum(found * case.exact, axis=-1))
    there = (case.depth > 0) & (np.abs(found).sum(-1) > 0)
    return np.where(there, np.degrees(np.arctan2(across, along)), np.nan)


def beside_edges(depth: np.ndarray) -> np.ndarray:
    """Tell which pixels with depth lie by a step of it, or by where there is none."""
    step = np.zeros(depth.shape, np.uint8)
    for axis in (0, 1):
        near, far = (depth[tuple(s)] for s in _neighbours(axis))
        edge = np.abs(near - far) > EDGE_STEP * np.minimum(near, far)
        for s in _neighbours(axis):
            step[tuple(s)] |= edge
    # The step itself is the first pixel.
    size = 2 * EDGE_PX - 1
    return (cv2.dilate(step, np.ones((size, size), np.uint8)) > 0) & (depth > 0)


def _neighbours(axis: int) -> tuple[list[slice], list[slice]]:
    first, second = [slice(None), slice(None)], [slice(None), slice(None)]
    first[axis], second[axis] = slice(None, -1), slice(1, None)
    return first, second


def print_errors(data: Path, times: dict[str, float]) -> None:
    """Print methods by kind of scene, then nim, nim-edge and D2NT v3 on each scene."""
    cases = [*reference_cases(data), *street_cases()]
    kinds = ["clean", "edges", "mm", "independent", "stereo"]
    named = [c.name for c in cases if c.kind == "clean" and not c.name.startswith("street")]
    print("| mean error, degrees | " + " | ".join([*named, "streets, clean"]), end=" | ")
    print(
        f"clean, within {EDGE_PX} px of an edge | in mm | independent noise | stereo noise", end=""
    )
    print(" | time / nim's |\n| --- |" + " ---: |" * (len(named) + len(kinds) + 1))
    each: dict[str, dict[str, float]] = {}
    missing = {}
    for name, method in methods().items():
        errors = {(c.kind, c.name): angles(method(c.depth, c.camera), c) for c in cases}
        each[name] = {f"{c.name}, {c.kind}": np.nanmean(errors[c.kind, c.name]) for c in cases}
        row = [each[name][f"{n}, clean"] for n in named]
        for kind in kinds:
            of = [c for c in cases if c.kind == ("clean" if kind == "edges" else kind)]
            of = of if kind == "edges" else [c for c in of if c.name not in named]
            masks = [beside_edges(c.depth) if kind == "edges" else c.depth > 0 for c in of]
            pairs = zip(of, masks, strict=True)
            row.append(np.mean([np.nanmean(errors[c.kind, c.name][m]) for c, m in pairs]))
        lost = [np.isnan(errors[c.kind, c.name][c.depth > 0]).mean() for c in cases]
        missing[name] = float(np.mean(lost))
        ratio = f"{times[name] / times['nimprep nim']:.1f}" if name in times else ""
        print(f"| {name} | " + " | ".join(f"{e:.2f}" for e in row) + f" | {ratio} |")
    for name, share in missing.items():
        if share > 0:
            print(f"{name}: no normal at {share:.1%} of the pixels with depth")
    columns = [n for n in ("nimprep nim", "nimprep nim-edge", "d2nt v3") if n in each]
    print(f"\n| scene | {' | '.join(columns)} |\n| --- |" + " ---: |" * len(columns))
    for scene in each[columns[0]]:
        print(f"| {scene} | " + " | ".join(f"{each[n][scene]:.3f}" for n in columns) + " |")
