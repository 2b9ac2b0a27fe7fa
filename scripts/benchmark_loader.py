"""Training samples per second from a store and from the same frames in other formats, in one run.

    python scripts/benchmark_loader.py [--frames N] [--rounds N] [--dtype stored]
                                       [--modalities rgb,depth,normal,label] [--only NAME ...]

Frames are 1280x720: the real GMRP frame, where the reference data is there, shifted sideways by a
random number of columns, which come in again at the other side, and every other one mirrored: so
frames differ and keep the sensor's own noise. Else synthetic frames. Batches of 4, shuffled, page
cache warm, each loader's first epoch not counted; the rows take turns, and the median is printed.
Columns: samples/s in one process (StoreLoader and FFCV: with one thread), with two workers (two
threads), and the bytes on disk of the modalities read.

The other formats are optional:

    pip install litdata mosaicml-streaming webdataset h5py hdf5plugin ffcv
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import loader_formats as formats
import numpy as np
import torch
from loader_formats import BATCH, Arrays, Finish, Format

import nimprep
from nimprep.synthetic import write_synthetic
from nimprep.torch import StoreDataset, StoreLoader

OTHERS: dict[str, Callable[..., Format]] = {
    "PNG folder": formats.make_png,
    "webdataset, PNG": formats.make_webdataset,
    "HDF5 zstd": formats.make_hdf5_zstd,
    "HDF5 lz4": formats.make_hdf5_lz4,
    "litdata zstd": formats.make_litdata_zstd,
    "litdata raw": formats.make_litdata_raw,
    "MDS raw": formats.make_mds,
    "memory map": formats.make_memmap,
    "FFCV raw": formats.make_ffcv,
}
RAW = ("litdata raw", "MDS raw", "memory map", "FFCV raw")


def write_raw(root: Path, frames: int) -> Path:
    """Write a folder in GMRP's layout with so many 720p frames, no two alike."""
    data = Path(os.environ.get("NIMPREP_REFERENCE_DATA", "../shared/data")) / "gmrp"
    if not data.is_dir():
        return write_synthetic(root, frames, size=(720, 1280))
    rng = np.random.default_rng(0)
    shifts = rng.permutation(1280)[:frames]
    for folder in ("rgb", "depth_u16", "label"):
        (root / folder).mkdir(parents=True)
        image = cv2.imread(str(data / folder / "000001.png"), cv2.IMREAD_UNCHANGED)
        for number, shift in enumerate(shifts):
            changed = np.roll(image, int(shift), axis=1)[:, :: 1 if number % 2 else -1]
            cv2.imwrite(str(root / folder / f"{number:06d}.png"), changed)
    return root


def size_of(folder: Path) -> int:
    """Return the bytes of all files below."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def rate(row: Format, workers: int, frames: int) -> float:
    """Return the samples/s of one row's second epoch."""
    if not row.isolated:
        return samples_per_second(row, workers, frames)
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(samples_per_second, row, workers, frames).result()


def samples_per_second(row: Format, workers: int, frames: int) -> float:
    """Time the second epoch."""
    torch.set_num_threads(1)
    batches = row.batches(workers)
    for _ in batches:
        pass
    start = time.perf_counter()
    for _ in batches:
        pass
    return frames / (time.perf_counter() - start)


def store_rows(path: Path, names: tuple[str, ...], dtype: Any) -> dict[str, Format]:
    """Return the store read by torch's DataLoader and by StoreLoader."""
    dataset = StoreDataset(path, None, modalities=names, dtype=dtype)

    def threads(number: int, **options: Any) -> Iterable[Any]:
        return StoreLoader(dataset, BATCH, True, max(number, 1), **options)

    return {
        "store, DataLoader": Format(lambda n: formats.loader(dataset, n, shuffle=True)),
        "store, StoreLoader": Format(threads),
        "store, StoreLoader, reuse": Format(lambda n: threads(n, reuse_buffers=True)),
    }


def other_rows(
    scratch: Path, frames: list[Arrays], finish: Finish, only: list[str] | None
) -> tuple[dict[str, Format], dict[str, int]]:
    """Write every other format that is installed."""
    rows, sizes = {}, {}
    for name, make in OTHERS.items():
        if only and name not in only:
            continue
        folder = scratch / name.replace(" ", "_").replace(",", "")
        folder.mkdir()
        try:
            rows[name] = make(frames, folder, finish)
            sizes[name] = size_of(folder)
        except ImportError as error:
            print(f"{name}: not installed ({error})")
    return rows, sizes


def measure(rows: dict[str, Format], frames: int, rounds: int) -> dict[tuple[str, int], float]:
    """Return the median samples/s of each row without and with two workers, taking turns."""
    found: dict[tuple[str, int], list[float]] = {(n, w): [] for n in rows for w in (0, 2)}
    for _ in range(rounds):
        for name, workers in found:
            found[name, workers].append(rate(rows[name], workers, frames))
    return {key: float(np.median(rates)) for key, rates in found.items()}


def report(rates: dict[tuple[str, int], float], sizes: dict[str, int]) -> None:
    """Print the table and what it says of the store."""
    print(f"\n{'':<28}{'1 process':>10}{'2 workers':>10}{'MB':>7}   samples/s")
    for name in dict.fromkeys(name for name, _ in rates):
        print(f"{name:<28}{rates[name, 0]:10.0f}{rates[name, 2]:10.0f}{sizes[name] / 1e6:7.0f}")
    print()
    ours = [n for n in sizes if n.startswith("store")]
    best = max(ours, key=lambda n: rates[n, 2])
    fast, file = max(rates[best, w] for w in (0, 2)), sizes[best]
    for name in sizes:
        if name not in ours:
            other = max(rates[name, 0], rates[name, 2])
            print(
                f"{best} against {name}: {fast / other:.2f} times the best of both columns "
                f"({rates[best, 0] / rates[name, 0]:.2f} and {rates[best, 2] / rates[name, 2]:.2f} "
                f"column by column), {file / sizes[name]:.2f} times the bytes"
            )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=48)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--dtype", choices=("float32", "stored"), default="float32")
    parser.add_argument("--modalities", default="rgb,depth,label")
    parser.add_argument("--only", nargs="*")
    options = parser.parse_args()
    formats.quiet()
    names = tuple(options.modalities.split(","))
    with tempfile.TemporaryDirectory() as scratch_name:
        scratch = Path(scratch_name)
        store = nimprep.convert(write_raw(scratch / "raw", options.frames), scratch / "store.zarr")
        shutil.rmtree(scratch / "raw")
        stored = [{n: store.arrays[n].read(i) for n in names} for i in range(options.frames)]
        rows, sizes = other_rows(scratch, stored, Finish(names, options.dtype), options.only)
        del stored
        ours = store_rows(store.path, names, options.dtype)
        sizes |= {name: sum(size_of(store.path / n) for n in names) for name in ours}
        print(f"{options.modalities} as {options.dtype}, {options.frames} frames of 1280x720")
        report(measure(rows | ours, options.frames, options.rounds), sizes)


if __name__ == "__main__":
    main()
