"""Work over frames on threads: decoding, matching and compressing leave Python's lock alone."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

from nimprep.derive.threads import available_cores

Progress = Callable[[str, int], Callable[[], None]]
"""Called with the step's name and its number of frames; returns what to call after each frame."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def map_frames(
    step: str,
    function: Callable[[Item], Result],
    items: Sequence[Item],
    progress: Progress | None = None,
) -> Iterator[Result]:
    """Yield the function's result for each item, in order, a few computed ahead.

    The first error ends it; frames not yet begun are dropped. At most two results per core wait in
    memory.
    """
    done = progress(step, len(items)) if progress is not None else _nothing
    workers = available_cores()
    queue = iter(items)
    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[Future[Result]] = deque(
            pool.submit(function, item) for item in islice(queue, 2 * workers)
        )
        try:
            while waiting:
                result = waiting.popleft().result()
                waiting.extend(pool.submit(function, item) for item in islice(queue, 1))
                yield result
                done()
        finally:
            for future in waiting:
                future.cancel()


def _nothing() -> None:
    """Take the place of a progress bar."""
