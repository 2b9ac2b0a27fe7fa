"""How many frames to put into a shard: writing, opening and reading, in one run.

    python scripts/benchmark_shards.py [--frames N] [--rounds N]

Times are medians over rounds in which the lengths take turns, given relative to shards of one
frame. "first" opens the store and reads a frame, as a worker does once; "next" reads a frame of a
store that is open, shuffled. Files are those of a GMRP-sized dataset (3896 frames).
"""

from __future__ import annotations

import argparse
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

import nimprep
from nimprep.synthetic import write_synthetic

LENGTHS = (1, 8, 32, 128)
GMRP_FRAMES = 3896


def timed(path: Path, number: int) -> tuple[float, float]:
    """Return the seconds for a first frame and for the next."""
    start = time.perf_counter()
    store = nimprep.open_store(path)
    frame = store[number % len(store)]
    _ = frame.rgb, frame.depth_m, frame.label
    first = time.perf_counter()
    frame = store[(number * 7 + 3) % len(store)]
    _ = frame.rgb, frame.depth_m, frame.label
    return first - start, time.perf_counter() - first


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=128)
    parser.add_argument("--rounds", type=int, default=40)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as name:
        raw = write_synthetic(Path(name) / "raw", options.frames, size=(240, 320))
        writing, paths = {}, {}
        for length in LENGTHS:
            paths[length] = Path(name) / f"{length}.zarr"
            start = time.perf_counter()
            nimprep.convert(raw, paths[length], shard_length=length, overwrite=True)
            if length == LENGTHS[0]:
                # The first conversion compiles; it is done again.
                start = time.perf_counter()
                nimprep.convert(raw, paths[length], shard_length=length, overwrite=True)
            writing[length] = time.perf_counter() - start
        times: dict[int, list[tuple[float, float]]] = {length: [] for length in LENGTHS}
        for number in range(options.rounds):
            for length in LENGTHS:
                times[length].append(timed(paths[length], number))
        median = {length: np.median(times[length], axis=0) for length in LENGTHS}
        print(f"{'frames':>8}{'write':>8}{'first':>8}{'next':>8}{'bytes':>8}{'files':>8}")
        sizes = {
            length: sum(p.stat().st_size for p in path.rglob("*") if p.is_file())
            for length, path in paths.items()
        }
        for length in LENGTHS:
            first, following = median[length] / median[1]
            arrays = len(nimprep.open_store(paths[length]).modalities)
            files = arrays * -(-GMRP_FRAMES // length)
            print(
                f"{length:>8}{writing[length] / writing[1]:>8.2f}{first:>8.2f}{following:>8.2f}"
                f"{sizes[length] / sizes[1]:>8.3f}{files:>8}"
            )


if __name__ == "__main__":
    main()
