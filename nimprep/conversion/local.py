"""Encoding units on this machine: threads share the frames, one more thread writes shards."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from nimprep.conversion.job import Job, UnitBuilder
from nimprep.conversion.records import UnitRecord
from nimprep.errors import NimprepError
from nimprep.parallel import in_order
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
    ids = [frame_id for number in todo for frame_id in units[number]]
    writing: deque[Future[UnitRecord]] = deque()
    with (
        ThreadPoolExecutor(workers, thread_name_prefix="nimprep") as pool,
        ThreadPoolExecutor(1, thread_name_prefix="nimprep-writer") as writer,
    ):
        encoded = in_order(lambda i: pool.submit(job.encode, reader, i), ids, 2 * workers)
        try:
            for number in todo:
                builder = UnitBuilder(number, job)
                for _ in units[number]:
                    builder.add(next(encoded).result())
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
