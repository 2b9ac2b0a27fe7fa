"""Reading frames from a store against decoding their PNGs, in one run.

    python scripts/benchmark_read.py [--frames N] [--rounds N]

The frame is the real 720p GMRP frame where the reference data is there, else a synthetic one.
Rows: OpenCV decoding the three PNGs; `open_store(...)[i]` with rgb, depth and label; the same
through zarr-python.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import zarr

import nimprep
from nimprep.synthetic import write_synthetic


def dataset(scratch: Path, frames: int) -> Path:
    """Return a folder in GMRP's layout with so many 720p frames."""
    data = Path(os.environ.get("NIMPREP_REFERENCE_DATA", "../shared/data")) / "gmrp"
    if not data.is_dir():
        return write_synthetic(scratch / "raw", frames, size=(720, 1280))
    for folder in ("rgb", "depth_u16", "label"):
        (scratch / "raw" / folder).mkdir(parents=True)
        for number in range(frames):
            target = scratch / "raw" / folder / f"{number:06d}.png"
            shutil.copyfile(data / folder / "000001.png", target)
    return scratch / "raw"


def milliseconds(calls: dict[str, Callable[[int], object]], rounds: int) -> dict[str, float]:
    """Return each call's median, the calls taking turns so that noise meets them alike."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for number in range(rounds):
        for name, call in calls.items():
            start = time.perf_counter()
            call(number)
            times[name].append(time.perf_counter() - start)
    return {name: 1e3 * float(np.median(values)) for name, values in times.items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--rounds", type=int, default=60)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        raw = dataset(scratch, options.frames)
        pngs = [
            [raw / folder / f"{n:06d}.png" for folder in ("rgb", "depth_u16", "label")]
            for n in range(options.frames)
        ]
        source = sum(path.stat().st_size for row in pngs for path in row)
        for codec in ("fast", "small"):
            nimprep.convert(raw, scratch / f"{codec}.zarr", codec=codec)
        stores = {c: nimprep.open_store(scratch / f"{c}.zarr") for c in ("fast", "small")}
        group = zarr.open_group(scratch / "fast.zarr", mode="r")

        def from_store(store: nimprep.Store, i: int) -> object:
            frame = store[i % options.frames]
            return frame.rgb, frame.depth_m, frame.label

        found = milliseconds(
            {
                "three PNGs, OpenCV": lambda i: [
                    cv2.imread(str(p), cv2.IMREAD_UNCHANGED) for p in pngs[i % options.frames]
                ],
                "store, codec fast": lambda i: from_store(stores["fast"], i),
                "store, codec small": lambda i: from_store(stores["small"], i),
                "store fast by zarr-python": lambda i: [
                    group[m][i % options.frames] for m in ("rgb", "depth", "label")
                ],
            },
            options.rounds,
        )
        base = found["three PNGs, OpenCV"]
        print(f"rgb + depth + label of one frame, median of {options.rounds} in turns\n")
        print(f"{'':<28}{'ms':>8}{'times as fast':>16}")
        for row, value in found.items():
            print(f"{row:<28}{value:8.2f}{base / value:16.1f}")
        print()
        for codec, store in stores.items():
            size = sum(
                p.stat().st_size
                for m in ("rgb", "depth", "label")
                for p in (store.path / m / "c").rglob("*")
                if p.is_file()
            )
            print(f"codec {codec}: {size / source:.2f} times the PNGs' bytes")


if __name__ == "__main__":
    main()
