"""Frames per second of `nimprep.convert`, against what decoding and compressing alone would take.

    python scripts/benchmark_convert.py [--frames N] [--rounds N] [--memory 100 400 1000 4000]
                                        [--memory-size HEIGHT WIDTH] [--only speed|memory]

The floor decodes the same source PNGs by OpenCV and compresses the arrays of the finished store by
the store's codec, on as many threads; it checks, derives, hashes and writes nothing. Rows take
turns, and the median over the rounds is printed: wall time of the whole call, metadata and fsync
included, and the processor's time per frame, which other programs disturb less. "processes" gives
whole shards to processes that are already running, in place of single frames to threads.

Frames are 1280x720: the real GMRP frame, where the reference data is there, shifted and mirrored so
that no two are alike; else synthetic frames. Memory is the peak of a fresh process (VmHWM), its
source made of hard links to a few files.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from functools import cache
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from benchmark_loader import write_raw
from numcodecs import blosc

import nimprep
from nimprep.conversion import run as run_module
from nimprep.conversion.encode import encode_unit
from nimprep.conversion.plan import Job
from nimprep.conversion.records import UnitRecord
from nimprep.readers import Reader, open_reader
from nimprep.synthetic import write_synthetic

FOLDERS = ("rgb", "depth_u16", "label")
WORKERS = (1, 2)
SHARD_LENGTH = 8
"""Frames per unit: small enough that two processes share a short run evenly."""


def cpu_seconds() -> float:
    """Return the processor's time of this process and of its finished children."""
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def compress(image: np.ndarray, codec: dict[str, Any]) -> bytes:
    """Compress as the store does, without a checksum."""
    shuffle = {"noshuffle": 0, "shuffle": 1, "bitshuffle": 2}[codec["shuffle"]]
    name, level, size = codec["cname"].encode(), codec["clevel"], codec["typesize"]
    return blosc.compress(image, name, level, shuffle, codec["blocksize"], typesize=size)


class Floor:
    """Decode every source image and compress every array of the store, and nothing else.

    Parameters
    ----------
    raw : Path
        The source.
    store : Store
        What it became; its first frames' arrays are held in memory and compressed in turns.
    """

    def __init__(self, raw: Path, store: nimprep.Store, held: int = 8) -> None:
        layout = [(name, store.arrays[name]) for name in store.modalities]
        specs = {name: codec_of(store, name) for name in store.modalities}
        self._arrays = [
            [(array.read(i), specs[name]) for name, array in layout]
            for i in range(min(held, len(store)))
        ]
        self._files = [[raw / folder / f"{i}.png" for folder in FOLDERS] for i in store.ids]

    def frame(self, number: int) -> None:
        """Do one frame's work."""
        for path in self._files[number]:
            cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_UNCHANGED)
        for image, codec in self._arrays[number % len(self._arrays)]:
            compress(image, codec)

    def run(self, workers: int) -> None:
        """Do every frame's."""
        with ThreadPoolExecutor(workers) as pool:
            for _ in pool.map(self.frame, range(len(self._files))):
                pass


def codec_of(store: nimprep.Store, name: str) -> dict[str, Any]:
    """Return an array's Blosc settings, from its metadata."""
    import zarr

    array = zarr.open_group(store.path, mode="r")[name]
    settings = array.metadata.to_dict()["codecs"][0]["configuration"]["codecs"][1]
    assert settings["name"] == "blosc"
    return settings["configuration"]


_POOLS: dict[int, ProcessPoolExecutor] = {}


def encode_by_processes(
    job: Job, reader: Reader, todo: Sequence[int], done: Callable[[], None]
) -> Generator[UnitRecord]:
    """Encode units as `nimprep.conversion.encode.encode_units` does, by processes."""
    workers = job.options.workers or 1
    if workers not in _POOLS:
        _POOLS[workers] = ProcessPoolExecutor(workers, get_context("spawn"))
    pool, left, waiting = _POOLS[workers], iter(todo), set[Future[UnitRecord]]()
    while True:
        more = islice(left, 2 * workers - len(waiting))
        waiting |= {pool.submit(encode_in_process, job, number) for number in more}
        if not waiting:
            return
        finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
        for future in finished:
            yield future.result()


def encode_in_process(job: Job, number: int) -> UnitRecord:
    """Encode one unit on a thread that is not the main one, where Blosc would start its own."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(encode_unit, job, opened(job.source), number).result()


@cache
def opened(source: Path) -> Reader:
    """Open a source once per process."""
    warnings.simplefilter("ignore")
    return open_reader(source)


def convert(raw: Path, target: Path, workers: int) -> None:
    """Convert, over what is there."""
    nimprep.convert(raw, target, workers=workers, shard_length=SHARD_LENGTH, overwrite=True)


def convert_by_processes(raw: Path, target: Path, workers: int) -> None:
    """Convert with processes in place of threads."""
    threads = run_module.encode_units
    run_module.encode_units = encode_by_processes
    try:
        convert(raw, target, workers)
    finally:
        run_module.encode_units = threads


def measure(rows: dict[str, Callable[[int], None]], rounds: int) -> dict[tuple[str, int], Any]:
    """Return (wall, processor) seconds per round of each row and number of workers."""
    found: dict[tuple[str, int], list[tuple[float, float]]] = {
        (name, workers): [] for workers in WORKERS for name in rows
    }
    for _ in range(rounds):
        for name, workers in found:
            wall, cpu = time.perf_counter(), cpu_seconds()
            rows[name](workers)
            found[name, workers].append((time.perf_counter() - wall, cpu_seconds() - cpu))
    return {key: np.array(times) for key, times in found.items()}


def speed(scratch: Path, frames: int, rounds: int) -> None:
    """Print frames per second and how much of the floor that is."""
    raw, target = write_raw(scratch / "raw", frames), scratch / "store.zarr"
    convert(raw, target, max(WORKERS))  # compiles, and makes what the floor compresses
    floor = Floor(raw, nimprep.open_store(target))
    rows: dict[str, Callable[[int], None]] = {
        "floor": floor.run,
        "convert": lambda workers: convert(raw, target, workers),
        "processes": lambda workers: convert_by_processes(raw, target, workers),
    }
    for workers in WORKERS:
        rows["processes"](workers)  # starts them
    times = measure(rows, rounds)
    print(f"{frames} frames of 1280x720, all modalities, medians of {rounds} rounds")
    print(f"{'':<12}{'workers':>8}{'frames/s':>10}{'of floor':>10}{'CPU ms':>8}{'of floor':>10}")
    for name, workers in times:
        wall, cpu = np.median(times[name, workers], axis=0)
        ratios = np.median(times["floor", workers] / times[name, workers], axis=0)
        # Children count only once they are gone, so that processes have no figure here.
        cpus = f"{1e3 * cpu / frames:8.0f}{ratios[1]:10.1%}" if name != "processes" else ""
        print(f"{name:<12}{workers:>8}{frames / wall:10.2f}{ratios[0]:10.1%}{cpus}")
    for name in rows:
        gain = np.median(times[name, 1][:, 0] / times[name, 2][:, 0])
        print(f"{name}: 2 workers {gain:.2f} times as fast as 1")


def link_frames(root: Path, frames: int, size: tuple[int, int]) -> Path:
    """Make a source of so many frames out of hard links to the files of eight."""
    few = root / "few"
    if not few.is_dir():
        write_synthetic(few, 8, size=size)
    many = root / f"{frames}"
    for folder in FOLDERS:
        (many / folder).mkdir(parents=True)
        for number in range(frames):
            os.link(few / folder / f"{number % 8:06d}.png", many / folder / f"{number:06d}.png")
    (many / "camera.json").write_bytes((few / "camera.json").read_bytes())
    return many


PEAK = """
import sys, nimprep
nimprep.convert(sys.argv[1], sys.argv[2], workers=2)
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""


def memory(scratch: Path, counts: Sequence[int], size: tuple[int, int]) -> None:
    """Print the peak memory of conversions of more and more frames."""
    print(f"peak memory, frames of {size[1]}x{size[0]}, 2 workers, 32 frames per shard")
    for frames in counts:
        source = link_frames(scratch, frames, size)
        command = [sys.executable, "-c", PEAK, str(source), str(scratch / f"{frames}.zarr")]
        start = time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        seconds = time.perf_counter() - start
        print(f"{frames:>8} frames{int(done.stdout) / 1024:8.0f} MiB{frames / seconds:8.0f} /s")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=48)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--memory", type=int, nargs="*", default=[100, 400, 1000, 4000])
    parser.add_argument("--memory-size", type=int, nargs=2, default=(120, 160))
    parser.add_argument("--only", choices=("speed", "memory"))
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as name:
        if options.only != "memory":
            speed(Path(name), options.frames, options.rounds)
        if options.only != "speed":
            memory(Path(name), options.memory, tuple(options.memory_size))


if __name__ == "__main__":
    main()
