"""How fast this nimprep reads and converts against another checkout of it, taken in turns.

    python scripts/benchmark_versions.py OTHER [--frames N] [--rounds N]

OTHER is the source folder of another version, such as `git worktree add ../old v0.1.0` makes. Each
version converts the same 1280x720 frames into a store of its own format, and reads that one; every
measurement is a process of its own, the two versions take turns, and the ratio of each round's two
is printed as its median: above 1, this version is faster.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmark_loader import write_raw

OURS = Path(__file__).resolve().parent.parent

READ = """
import sys, time, torch
from nimprep.torch import StoreDataset, StoreLoader
torch.set_num_threads(1)
names = ("rgb", "depth", "normal", "label")
path, threads, dtype = sys.argv[1], int(sys.argv[2]), sys.argv[3]
loader = StoreLoader(StoreDataset(path, None, modalities=names, dtype=dtype), 4, True, threads)
for _ in loader: pass
start = time.perf_counter()
for _ in range(3):
    for _ in loader: pass
print(3 * len(loader.dataset) / (time.perf_counter() - start))
"""

FRAME = """
import sys, time, nimprep
store = nimprep.open_store(sys.argv[1])
def read():
    for frame in store: frame.rgb, frame.depth_m, frame.label
read()
start = time.perf_counter()
read()
print(len(store) / (time.perf_counter() - start))
"""

CONVERT = """
import shutil, sys, time, nimprep
start = time.perf_counter()
store = nimprep.convert(sys.argv[1], sys.argv[2], camera=(900.0, 900.0, 639.5, 359.5))
print(len(store) / (time.perf_counter() - start))
"""


def run(version: Path, code: str, *arguments: object) -> float:
    """Return what a piece of code prints that runs with a version of nimprep."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(version)},
        capture_output=True,
        text=True,
        check=True,
    )
    return float(done.stdout)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("other", type=Path)
    parser.add_argument("--frames", type=int, default=32)
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        raw = write_raw(folder / "raw", options.frames)
        versions = {"ours": OURS, "other": options.other.resolve()}
        stores = {name: folder / f"{name}.zarr" for name in versions}
        for name, version in versions.items():
            run(version, CONVERT, raw, stores[name])
        rows: dict[str, tuple[str, tuple[object, ...]]] = {
            f"StoreLoader, {dtype}, {threads} thread{'s' * (threads > 1)}": (READ, (threads, dtype))
            for dtype in ("float32", "stored")
            for threads in (1, 2)
        }
        rows["open_store(...)[i]: rgb, depth, label"] = (FRAME, ())
        for row, (code, arguments) in rows.items():
            ratios = []
            for number in range(options.rounds):
                order = list(versions) if number % 2 else list(reversed(versions))
                rates = {n: run(versions[n], code, stores[n], *arguments) for n in order}
                ratios.append(rates["ours"] / rates["other"])
            low, high = min(ratios), max(ratios)
            print(
                f"{row:<42}{statistics.median(ratios):6.3f}  ({low:.2f} to {high:.2f})", flush=True
            )


if __name__ == "__main__":
    main()
