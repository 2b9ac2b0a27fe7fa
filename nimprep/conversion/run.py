"""The run as a whole: read, encode and write every frame; all of it or nothing."""

from __future__ import annotations

import hashlib
import shutil
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.conversion.encode import EncodedFrame, encode_frame
from nimprep.conversion.options import ConvertOptions
from nimprep.conversion.plan import check_apart, describe, plan_layout, plan_splits
from nimprep.derive.modalities import Recipe
from nimprep.derive.threads import available_cores
from nimprep.readers import Reader, open_reader
from nimprep.readers.crop import CroppedReader, Margins, find_invalid_sides
from nimprep.splits import SPLIT_CODES
from nimprep.store.reader import Store, open_store
from nimprep.store.writer import StoreWriter, check_target, make_partial, move_into_place

Progress = Callable[[str, int], Callable[[], None]]
"""Called with a step's name and its number of frames; returns what to call after each frame."""


def convert(
    source: Path | str,
    target: Path | str,
    options: ConvertOptions | None = None,
    *,
    progress: Progress | None = None,
    **changes: Any,
) -> Store:
    """Convert a raw dataset into a store.

    Parameters
    ----------
    source : path
        The dataset's folder; nothing in it is written to.
    target : path
        The store's folder, ending in .zarr by custom. It is written in a hidden folder beside its
        place and gets its name when it is complete; until then what is there stays.
    options : ConvertOptions, optional
    progress : callable, optional
        Called with a step's name and its number of frames; what it returns is called after each.
    **changes
        Fields of `ConvertOptions`, over those of `options`.

    Returns
    -------
    Store
        The new store, open.

    Raises
    ------
    LayoutError, DecodeError, CameraError
        The dataset is not what it should be; the file is named.
    SplitError
        The split rule or file does not fit the frames.
    StoreError
        The target cannot be written, or must not be.
    """
    options = replace(options or ConvertOptions(), **changes)
    source, target = Path(source), Path(target)
    check_apart(source, target)
    workers = options.workers or available_cores()
    start = progress or (lambda step, frames: lambda: None)
    reader = open_reader(source, options.reader, options.reading)
    if options.crop == "auto":
        done = start("looking for sides without depth", len(reader.ids))
        reader = CroppedReader(reader, find_invalid_sides(reader, workers, done))
    elif options.crop is not None:
        reader = CroppedReader(reader, Margins(*options.crop))
    layout = plan_layout(reader, options)
    # Splits are made before anything is written: a wrong split file must not cost a conversion.
    splits = plan_splits(reader, options)
    check_target(target, overwrite=options.overwrite)
    partial = make_partial(target)
    try:
        attributes = describe(reader, layout, options)
        writer = StoreWriter(partial, layout, attributes)
        done = start("converting", len(reader.ids))
        collected = Collected(splits)
        write_images(reader, writer, options.recipe, workers, collected, done)
        writer.finish(collected.tables(), {**attributes, **collected.summary()})
        move_into_place(partial, target, overwrite=options.overwrite)
    finally:
        # Gone by now where all went well.
        shutil.rmtree(partial, ignore_errors=True)
    # Said last, beside the summary: at the start it would scroll away, and bad data gets one line.
    for note in reader.info.notes:
        warnings.warn(f"{source}: {note}", stacklevel=2)
    return open_store(target)


class Collected:
    """Gather, frame by frame, what a store says of its frames beside their images."""

    def __init__(self, splits: Sequence[str]) -> None:
        self._splits = splits
        self._ids: list[str] = []
        self._frames: list[EncodedFrame] = []
        self._depth_counts = np.zeros(65536, dtype=np.int64)

    def add(self, frame_id: str, frame: EncodedFrame) -> None:
        """Take in a frame; its chunks and its histogram are not kept."""
        self._depth_counts += frame.depth_counts
        self._ids.append(frame_id)
        self._frames.append(replace(frame, chunks={}, depth_counts=self._depth_counts[:0]))

    def tables(self) -> dict[str, npt.NDArray[Any]]:
        """Return the per-frame arrays, by the names of `TABLES`."""
        frames = self._frames
        return {
            "frame_id": np.array(self._ids, dtype="T"),
            "split": np.array([SPLIT_CODES[s] for s in self._splits], dtype=np.uint8),
            "group": np.array([f.group for f in frames], dtype="T"),
            "image_size": np.array([f.camera.shape for f in frames], dtype=np.int32),
            "intrinsics": np.array([f.camera.matrix for f in frames]),
            "baseline": np.array([f.baseline_m for f in frames]),
            "cam_to_road": np.array([f.cam_to_road for f in frames]),
            "gravity": np.array([f.gravity for f in frames]),
            "channel_sums": np.array([f.channel_sums for f in frames]),
        }

    def summary(self) -> dict[str, Any]:
        """Return what the root's attributes say of all frames together."""
        digest = hashlib.sha256()
        for frame_id, frame in zip(self._ids, self._frames, strict=True):
            digest.update(f"{frame_id}\0{frame.digest}\n".encode())
        return {
            "depth_percentiles_m": depth_percentiles(self._depth_counts),
            "source": {"digest": f"sha256:{digest.hexdigest()}"},
        }


def depth_percentiles(counts: npt.NDArray[np.int64]) -> dict[str, float] | None:
    """Return the 5th, 50th and 95th percentile, metres, of a histogram over millimetres.

    Each is the smallest depth that this share of the pixels with depth does not exceed.
    """
    below = np.cumsum(counts[1:])
    if below[-1] == 0:
        return None
    ranks = {str(p): -(-p * int(below[-1]) // 100) for p in (5, 50, 95)}
    return {p: (int(np.searchsorted(below, rank)) + 1) / 1000 for p, rank in ranks.items()}


def _in_order(
    pool: ThreadPoolExecutor,
    function: Callable[[str], EncodedFrame],
    ids: Sequence[str],
    ahead: int,
) -> Iterator[EncodedFrame]:
    """Yield results in order with at most `ahead` in the works, so that memory stays bounded."""
    waiting: deque[Future[EncodedFrame]] = deque()
    rest = iter(ids)
    try:
        for frame_id in rest:
            waiting.append(pool.submit(function, frame_id))
            if len(waiting) >= ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()


def write_images(
    reader: Reader,
    writer: StoreWriter,
    recipe: Recipe,
    workers: int,
    collected: Collected,
    done: Callable[[], None],
) -> None:
    """Encode every frame and write the shards.

    Threads share the work frame by frame: decoding, the kernels and compression release the GIL.
    Held in memory: one shard's compressed chunks and two frames per worker.
    """
    layout = writer.layout
    pending: dict[str, list[bytes]] = {m: [] for m in layout.modalities}

    def encode(frame_id: str) -> EncodedFrame:
        return encode_frame(reader, frame_id, layout, recipe)

    with ThreadPoolExecutor(workers, thread_name_prefix="nimprep") as pool:
        for number, frame in enumerate(_in_order(pool, encode, reader.ids, 2 * workers)):
            for modality, chunk in frame.chunks.items():
                pending[modality].append(chunk)
            collected.add(reader.ids[number], frame)
            if (number + 1) % layout.shard_length == 0 or number + 1 == layout.frames:
                for modality, chunks in pending.items():
                    writer.write_shard(modality, number // layout.shard_length, chunks)
                    chunks.clear()
            done()
