"""How to compress: size and decoding time of Blosc codecs on real frames, against their PNGs.

    python scripts/benchmark_codecs.py [--rounds N]

For each codec and kind of frame: bytes over the source PNG's bytes, and decoding time over the
time OpenCV takes to decode that PNG. The choice in nimprep/store/spec.py follows from this table;
schemas/README.md tells it.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numcodecs import blosc

import nimprep
from nimprep.modality import MODALITIES
from nimprep.store.frames import normals_to_integers, to_integers
from nimprep.synthetic import write_synthetic

CODECS = [
    ("lz4", 5),
    ("lz4hc", 5),
    ("lz4hc", 9),
    ("zstd", 1),
    ("zstd", 3),
    ("zstd", 7),
    ("zstd", 9),
]
SHUFFLES = {"noshuffle": 0, "shuffle": 1, "bitshuffle": 2}


def frames(data: Path, scratch: Path) -> dict[str, dict[str, Path]]:
    """Return the frames to try: kind to the PNG of each modality."""
    kinds = {
        "GMRP 720p": ("gmrp/rgb/000001", "gmrp/depth_u16/000001", "gmrp/label/000001"),
        "KITTI": (
            "kitti_road/training/image_2/uu_000000",
            "kitti_road/training/depth_u16/uu_000000",
            "kitti_road/training/gt_image_2/uu_road_000000",
        ),
    }
    found = {
        kind: {n: data / f"{p}.png" for n, p in zip(("rgb", "depth", "label"), paths, strict=True)}
        for kind, paths in kinds.items()
        if (data / f"{paths[0]}.png").is_file()
    }
    raw = write_synthetic(scratch / "raw", 1, size=(480, 640))
    found["synthetic"] = {
        "rgb": raw / "rgb/000000.png",
        "depth": raw / "depth_u16/000000.png",
        "label": raw / "label/000000.png",
    }
    return found


def images(kind: str, paths: dict[str, Path]) -> dict[str, np.ndarray]:
    """Return a frame's images as a store holds them, normals and HHA included."""
    rgb = cv2.imread(str(paths["rgb"]))[..., ::-1]
    raw = cv2.imread(str(paths["depth"]), cv2.IMREAD_UNCHANGED)
    depth_m = np.where(raw == 65535, 0, raw) / np.float32(1000)
    label = cv2.imread(str(paths["label"]), cv2.IMREAD_UNCHANGED)
    if label.ndim == 3:
        label = (label[..., 0] > 0).astype(np.uint8)
    camera = nimprep.Camera.from_fov(69.4, raw.shape[1], raw.shape[0])
    normal = nimprep.estimate_normals(depth_m, camera)
    return {
        "rgb": np.ascontiguousarray(rgb),
        "depth": to_integers(MODALITIES["depth"], depth_m),
        "label": label,
        "normal": normals_to_integers(normal, "int8"),
        "hha": nimprep.encode_hha(depth_m, camera),
    }


def seconds(call: Callable[[], object], rounds: int) -> float:
    """Return the median time of a call."""
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    rounds = parser.parse_args().rounds
    data = Path(os.environ.get("NIMPREP_REFERENCE_DATA", "../shared/data"))
    blosc.use_threads = False
    with tempfile.TemporaryDirectory() as scratch:
        for kind, paths in frames(data, Path(scratch)).items():
            table(kind, paths, rounds)


def table(kind: str, paths: dict[str, Path], rounds: int) -> None:
    """Print one kind's rows: modality, codec, bytes, decoding and encoding time."""
    print(f"\n{kind}: bytes and decoding time over the PNG's; modalities without one over raw\n")
    print(
        f"{'modality':<9}{'codec':<22}{'bytes':>8}{'decode':>9}{'decode ms':>11}{'encode ms':>11}"
    )
    for name, image in images(kind, paths).items():
        png = paths.get(name)
        size = png.stat().st_size if png else image.nbytes
        base = seconds(lambda p=png: cv2.imread(str(p), cv2.IMREAD_UNCHANGED), rounds) if png else 0
        for cname, level in CODECS:
            for shuffle, code in SHUFFLES.items():
                if shuffle == "shuffle" and image.itemsize == 1:
                    continue
                start = time.perf_counter()
                packed = blosc.compress(image, cname.encode(), level, code, 0)
                encoding = time.perf_counter() - start
                out = np.empty_like(image)
                decoding = seconds(lambda b=packed, o=out: blosc.decompress(b, o), rounds)
                ratio = f"{decoding / base:9.3f}" if base else f"{'':>9}"
                print(
                    f"{name:<9}{f'{cname} {level} {shuffle}':<22}{len(packed) / size:8.3f}{ratio}"
                    f"{decoding * 1e3:11.2f}{encoding * 1e3:11.1f}"
                )


if __name__ == "__main__":
    main()
