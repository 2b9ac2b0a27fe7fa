"""Blocks on threads: each once, errors passed on, no pool where none is wanted."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from nimprep.derive.threads import run_blocks
from nimprep.errors import ArrayError


@pytest.mark.parametrize("threads", [1, 2, 5, None])
@pytest.mark.parametrize("count", [0, 1, 2, 50])
def test_every_block_is_done_once(count: int, threads: int | None) -> None:
    done: list[int] = []
    run_blocks(done.append, count, threads)
    assert sorted(done) == list(range(count))


def test_one_thread_is_the_calling_one() -> None:
    seen = set()
    run_blocks(lambda _: seen.add(threading.get_ident()), 20, 1)
    assert seen == {threading.get_ident()}


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_in_a_block_reaches_the_caller(threads: int) -> None:
    def fail(block: int) -> None:
        if block == 7:
            raise KeyError("seven")

    with pytest.raises(KeyError, match="seven"):
        run_blocks(fail, 20, threads)


def test_blocks_may_run_blocks_themselves() -> None:
    done: list[int] = []

    def outer(block: int) -> None:
        run_blocks(lambda i: done.append(10 * block + i), 10, None)

    with ThreadPoolExecutor(4) as callers:
        for future in [callers.submit(run_blocks, outer, 8, None) for _ in range(4)]:
            future.result(timeout=30)
    assert sorted(done) == sorted(4 * list(range(80)))


@pytest.mark.parametrize("threads", [0, -1, 1.5, True])
def test_a_number_of_threads_that_is_none_is_refused(threads: object) -> None:
    with pytest.raises(ArrayError, match="num_threads: expected None or an integer >= 1"):
        run_blocks(print, 1, threads)
