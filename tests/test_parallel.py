"""Threads: blocks each once, results in order and few at a time, errors passed on."""

from __future__ import annotations

import os
import select
import signal
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import count as counted

import pytest

from nimprep.errors import ArrayError
from nimprep.parallel import in_order, map_frames, map_in_order, run_blocks
from tests.processes import PATIENCE_S


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
            future.result(timeout=PATIENCE_S)
    assert sorted(done) == sorted(4 * list(range(80)))


@pytest.mark.parametrize("threads", [0, -1, 1.5, True])
def test_a_number_of_threads_that_is_none_is_refused(threads: object) -> None:
    with pytest.raises(ArrayError, match="num_threads: expected None or an integer >= 1"):
        run_blocks(print, 1, threads)


@pytest.mark.parametrize("ahead", [1, 2, 5, 100])
def test_tasks_come_in_order_and_no_more_are_in_the_works_than_asked_for(ahead: int) -> None:
    submitted: list[int] = []

    def submit(item: int) -> Future[int]:
        submitted.append(item)
        task: Future[int] = Future()
        task.set_result(item)
        return task

    taken = []
    for task in in_order(submit, range(20), ahead):
        taken.append(task.result())
        assert len(submitted) == min(20, len(taken) + ahead - 1)
    assert taken == list(range(20))


def test_tasks_that_nobody_takes_any_more_are_cancelled() -> None:
    tasks: list[Future[int]] = []

    def submit(_: int) -> Future[int]:
        tasks.append(Future())
        return tasks[-1]

    taking = in_order(submit, counted(), 4)
    first = next(taking)
    taking.close()
    assert [task.cancelled() for task in tasks] == [False, True, True, True]
    assert first is tasks[0]


@pytest.mark.parametrize("threads", [1, 3, None])
def test_results_are_those_of_map(threads: int | None) -> None:
    assert list(map_in_order(lambda i: i * i, range(50), threads)) == [i * i for i in range(50)]


def test_the_first_error_in_order_ends_a_map_and_later_items_are_not_begun() -> None:
    begun: list[int] = []

    def fail(item: int) -> int:
        begun.append(item)
        if item >= 3:
            raise KeyError(item)
        return item

    results = map_in_order(fail, range(1000), 2)
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(KeyError, match="3"):
        next(results)
    assert max(begun) < 3 + 2 * 2


def test_a_map_that_is_left_leaves_no_thread_behind() -> None:
    before = threading.active_count()
    results = map_in_order(str, counted(), 3)
    assert next(results) == "0"
    results.close()
    assert threading.active_count() == before


def test_progress_hears_of_the_step_and_of_each_result_taken() -> None:
    told: list[object] = []

    def progress(step: str, frames: int) -> object:
        told.append((step, frames))
        return lambda: told.append("done")

    results = map_frames("draw", str, [7, 8], progress)
    assert (next(results), told) == ("7", [("draw", 2)])
    assert (next(results), told[1:]) == ("8", ["done"])
    assert (list(results), told[1:]) == ([], ["done", "done"])
    assert list(map_frames("draw", str, [])) == []


@pytest.mark.skipif(not hasattr(os, "fork"), reason="only systems with fork can do this")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_results_in_order_are_refused_in_a_process_forked_meanwhile() -> None:
    results = map_in_order(lambda n: n, range(100), 2)
    assert next(results) == 0
    source, sink = os.pipe()
    child = os.fork()
    if child == 0:
        # Nothing of pytest's may run here: the answer goes through the pipe, and that is all.
        try:
            said = f"went on to {next(results)}"
        except BaseException as error:
            said = str(error)
        os.write(sink, said.encode())
        os._exit(0)
    os.close(sink)
    answered = select.select([source], [], [], PATIENCE_S)[0]
    if not answered:
        os.kill(child, signal.SIGKILL)
    said = os.read(source, 1000).decode() if answered else "hung"
    os.waitpid(child, 0)
    os.close(source)
    assert said.startswith("nimprep: expected its iterator in the process that began it")
    assert list(results) == list(range(1, 100))
