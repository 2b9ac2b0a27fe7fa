"""Work on threads, over the rows of an image or over frames and files, and word of how far it is.

Decoding, matching, compressing and the kernels release the GIL, so threads run at once.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from typing import Protocol, TypeVar

from nimprep.errors import ArrayError, NimprepError

Progress = Callable[[str, int], Callable[[], None]]
"""Called with a step's name and its number of frames; returns what to call after each frame."""


class Task(Protocol):
    """What is in the works: a future, or several as one."""

    def cancel(self) -> object:
        """Drop it if it has not begun."""


Item = TypeVar("Item")
Result = TypeVar("Result")
AnyTask = TypeVar("AnyTask", bound=Task)

_pool: ThreadPoolExecutor | None = None

# Blocks for each thread: the last to end then keeps the others waiting for little.
_BLOCKS_PER_THREAD = 4

# Below this many pixels a block costs less than handing it to a thread.
_LEAST_BLOCK_PIXELS = 1 << 14


def available_cores() -> int:
    """Count the cores this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_blocks(function: Callable[[int], object], count: int, num_threads: int | None) -> None:
    """Call ``function(i)`` once for each i in 0..count-1, in any order, and wait for all.

    Parameters
    ----------
    function : callable
        One block's work. Blocks must write to places of their own; then the result is the same
        on any number of threads.
    count : int
        Number of blocks.
    num_threads : int or None
        None = one thread per core; 1 = the calling thread alone, without any pool.

    Raises
    ------
    ArrayError
        `num_threads` is not a positive integer or None.
    """
    threads = _checked_threads(num_threads)
    # Threads take the next block as they get free: cores of a shared machine are not equally fast.
    blocks = iter(range(count))
    helpers = min(threads, count) - 1
    futures = [_executor().submit(_work, function, blocks) for _ in range(helpers)]
    try:
        _work(function, blocks)
    finally:
        # Nobody may still write to the arrays once this returns, not even after an error. A helper
        # that has not begun by now is not needed.
        errors = [future.exception() for future in futures if not future.cancel()]
    for error in errors:
        if error is not None:
            raise error


def run_rows(
    function: Callable[[int, int], object], shape: tuple[int, ...], num_threads: int | None
) -> None:
    """Call ``function(first, last)`` for blocks of an image's rows, last exclusive.

    For kernels whose pixels do not depend on where a block begins.
    """
    threads = _checked_threads(num_threads)
    height, width = shape[:2]
    rows = max(-(-height // (threads * _BLOCKS_PER_THREAD)), _LEAST_BLOCK_PIXELS // width, 1)
    rows = height if threads == 1 else rows

    def run(block: int) -> None:
        function(block * rows, min((block + 1) * rows, height))

    run_blocks(run, -(-height // rows), num_threads)


@contextmanager
def threads_for(count: int, name: str = "nimprep") -> Iterator[ThreadPoolExecutor]:
    """Give a pool of threads for the context, which ends when they have.

    In a process forked meanwhile there are none to wait for, and their locks may be held for ever.
    """
    owner = os.getpid()
    pool = ThreadPoolExecutor(count, thread_name_prefix=name)
    try:
        yield pool
    finally:
        if os.getpid() == owner:
            pool.shutdown(wait=True, cancel_futures=True)


def _check_owner(owner: int, name: str) -> None:
    if os.getpid() != owner:
        raise NimprepError(
            f"{name}: expected its iterator in the process that began it, {owner}, found it "
            f"in one forked from there, {os.getpid()}; begin another one here with iter()"
        )


def in_order(
    submit: Callable[[Item], AnyTask], items: Iterable[Item], ahead: int, name: str = "nimprep"
) -> Generator[AnyTask]:
    """Submit items and yield their tasks in order, at most `ahead` in the works.

    So memory stays bounded: whoever takes a task waits for it, and has a next one submitted only by
    asking for it. Tasks that nobody asks for any more, after an error too, are cancelled.

    Raises
    ------
    NimprepError
        A forked process goes on with it, in which nobody works on the tasks; `name` says whose.
    """
    owner = os.getpid()
    waiting: deque[AnyTask] = deque()
    try:
        for item in items:
            _check_owner(owner, name)
            waiting.append(submit(item))
            if len(waiting) >= ahead:
                yield waiting.popleft()
        while waiting:
            _check_owner(owner, name)
            yield waiting.popleft()
    finally:
        for task in waiting if os.getpid() == owner else ():
            task.cancel()


def map_in_order(
    function: Callable[[Item], Result], items: Iterable[Item], num_threads: int | None = None
) -> Generator[Result]:
    """Yield the function's result for each item, in order, a few computed ahead.

    The first error ends it; items not yet begun are dropped, then and when it is closed. At most
    two results per thread (None = one thread per core) wait in memory.
    """
    threads = num_threads or available_cores()
    with threads_for(threads) as pool:
        tasks = in_order(lambda item: pool.submit(function, item), items, 2 * threads)
        with closing(tasks):
            for task in tasks:
                yield task.result()


def map_frames(
    step: str,
    function: Callable[[Item], Result],
    items: Sequence[Item],
    progress: Progress | None = None,
) -> Iterator[Result]:
    """Do as `map_in_order` on all cores, and tell `progress` of each result that was taken."""
    done = (progress or no_progress)(step, len(items))
    with closing(map_in_order(function, items)) as results:
        for result in results:
            yield result
            done()


def no_progress(step: str, frames: int) -> Callable[[], None]:
    """Take the place of a `Progress` that nobody gave."""
    return lambda: None


def _work(function: Callable[[int], object], blocks: Iterator[int]) -> None:
    for block in blocks:
        function(block)


def _checked_threads(num_threads: int | None) -> int:
    if num_threads is None:
        return available_cores()
    if isinstance(num_threads, bool) or int(num_threads) != num_threads or num_threads < 1:
        raise ArrayError(f"num_threads: expected None or an integer >= 1, found {num_threads!r}")
    return int(num_threads)


def _executor() -> ThreadPoolExecutor:
    """Return the pool shared by all calls, made when first needed."""
    global _pool
    if _pool is None:
        _pool = ThreadPoolExecutor(max_workers=available_cores(), thread_name_prefix="nimprep")
    return _pool


def _forget_pool() -> None:
    """Drop the pool in a forked child: its threads exist in the parent only."""
    global _pool
    _pool = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_pool)
