"""Encoding units on this machine: threads share the frames, one more thread writes shards."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from nimprep.conversion.encode import EncodedFrame
from nimprep.conversion.job import Job, UnitBuilder
from nimprep.conversion.records import SkippedFrame, UnitRecord
from nimprep.errors import NimprepError
from nimprep.readers import Reader


def encode_units(
    job: Job, reader: Reader, todo: Sequence[int], workers: int, done: Callable[[], None]
) -> Generator[UnitRecord]:
    """Encode and write units, in order; yield each one's record once its shards are written.

    Threads share the work frame by frame: decoding, the kernels and compression release the GIL.
    Held in memory: the compressed chunks of two units, and two frames per worker.

    Parameters
    ----------
    todo : sequence of int
        Units' numbers.
    done : callable
        Called after each frame.

    Raises
    ------
    NimprepError
        A frame is bad or the disk full; the units before it have been yielded.
    """
    units = job.units()
    frames = [(number, frame_id) for number in todo for frame_id in units[number]]
    writing: deque[Future[UnitRecord]] = deque()
    with (
        ThreadPoolExecutor(workers, thread_name_prefix="nimprep") as pool,
        ThreadPoolExecutor(1, thread_name_prefix="nimprep-writer") as writer,
    ):
        encoded = _in_order(pool, lambda i: job.encode(reader, i), frames, 2 * workers)
        try:
            for number in todo:
                builder = UnitBuilder(number, job)
                for _ in units[number]:
                    builder.add(next(encoded))
                    done()
                writing.append(writer.submit(builder.write))
                if len(writing) > 1:
                    yield writing.popleft().result()
        except NimprepError:
            # What is whole already must not be made again.
            while writing:
                yield writing.popleft().result()
            raise
        finally:
            encoded.close()
        while writing:
            yield writing.popleft().result()


def _in_order(
    pool: ThreadPoolExecutor,
    function: Callable[[str], EncodedFrame | SkippedFrame],
    frames: Sequence[tuple[int, str]],
    ahead: int,
) -> Generator[EncodedFrame | SkippedFrame]:
    """Yield results in order with at most `ahead` in the works, so that memory stays bounded."""
    waiting: deque[Future[EncodedFrame | SkippedFrame]] = deque()
    try:
        for _, frame_id in frames:
            waiting.append(pool.submit(function, frame_id))
            if len(waiting) >= ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()
