"""Small KITTI-like calibrations, images and folders whose truth is known."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from nimprep.kitti.calibration import Calibration, read_calibration

CAMERA_HEIGHT_M = 1.65
BASELINE_M = 0.54
FX = 60.0
WIDTH, HEIGHT = 120, 60

MATRICES = {
    "P2": np.array([[FX, 0, 59.5, FX * 0.06], [0, FX, 20.0, 0], [0, 0, 1, 0]]),
    "P3": np.array([[FX, 0, 59.5, FX * (0.06 - BASELINE_M)], [0, FX, 20.0, 0], [0, 0, 1, 0]]),
    "R0_rect": np.eye(3),
    # Scanner x forward, y left, z up to camera x right, y down, z forward.
    "Tr_velo_to_cam": np.array([[0.0, -1, 0, 0], [0, 0, -1, -0.08], [1, 0, 0, -0.27]]),
    "Tr_cam_to_road": np.hstack([np.eye(3), [[0], [-CAMERA_HEIGHT_M], [0]]]),
}


def rotation(axis: str, degrees: float) -> npt.NDArray[np.float64]:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    r = np.eye(3)
    r[i, i] = r[j, j] = c
    r[i, j], r[j, i] = -s, s
    return r


def calibration_text(**changes: npt.NDArray[np.float64] | str | None) -> str:
    lines = []
    for name, value in (MATRICES | changes).items():
        if value is not None:
            numbers = value if isinstance(value, str) else " ".join(f"{x:.12e}" for x in value.flat)
            lines.append(f"{name}: {numbers}")
    return "\n".join(lines) + "\n\n"


def write_calibration(path: Path, **changes: npt.NDArray[np.float64] | str | None) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(calibration_text(**changes))
    return path


def calibration(tmp_path: Path, **changes: npt.NDArray[np.float64] | str | None) -> Calibration:
    return read_calibration(write_calibration(tmp_path / "calib" / "um_000000.txt", **changes))


def write_png(path: Path, image: npt.NDArray[np.generic]) -> Path:
    """Write as OpenCV does: grey, or B, G, R."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)
    return path


def read_png(path: Path) -> npt.NDArray[np.generic]:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None, path
    return np.asarray(image)


def ground_truth(
    road: npt.NDArray[np.bool_], evaluated: npt.NDArray[np.bool_] | None = None
) -> npt.NDArray[np.uint8]:
    """Return (H, W, 3) uint8, B, G, R, in the benchmark's colours."""
    image = np.zeros((*road.shape, 3), np.uint8)
    image[..., 2] = 255 if evaluated is None else 255 * evaluated.astype(np.uint8)
    image[..., 0] = 255 * road.astype(np.uint8)
    return image


def noise(seed: int, *shape: int) -> npt.NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def road_folder(
    root: Path, names: tuple[str, ...] = ("um_000000",), split: str = "training"
) -> Path:
    """Make a road folder of small frames with image_2, calib, depth_u16 and, to train, truth."""
    for i, name in enumerate(names):
        folder = root / split
        write_png(folder / "image_2" / f"{name}.png", noise(i, HEIGHT, WIDTH, 3))
        write_calibration(folder / "calib" / f"{name}.txt")
        depth = np.full((HEIGHT, WIDTH), 8000 + i, np.uint16)
        write_png(folder / "depth_u16" / f"{name}.png", depth)
        if split == "training":
            road = np.zeros((HEIGHT, WIDTH), bool)
            road[30:, 20:100] = True
            category, number = name.split("_")
            for target in ("road", "lane") if category == "um" else ("road",):
                path = folder / "gt_image_2" / f"{category}_{target}_{number}.png"
                write_png(path, ground_truth(road))
    return root


def write_whole_benchmark(root: Path, parts: tuple[str, ...] = ("image_2", "calib")) -> Path:
    """Write all 289 training and 290 testing frames, every one of the same few bytes.

    `parts` name the folders; the truth of roads, to train, comes with them.
    """
    one = road_folder(root.parent / "one") / "training"
    numbers = {"training": (95, 96, 98), "testing": (96, 94, 100)}
    for split, counts in numbers.items():
        kinds = [(part, "") for part in parts]
        kinds += [("gt_image_2", "_road")] if split == "training" else []
        for part, kind in kinds:
            (source,) = (one / part).glob(f"um{kind}_000000.*")
            data = source.read_bytes()
            (root / split / part).mkdir(parents=True)
            for category, count in zip(("um", "umm", "uu"), counts, strict=True):
                for number in range(count):
                    name = f"{category}{kind}_{number:06d}{source.suffix}"
                    (root / split / part / name).write_bytes(data)
    return root
