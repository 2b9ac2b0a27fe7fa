"""Fuzzing with an end: so many examples, each with a limit on its time and its memory.

The examples are the same in every run. ``NIMPREP_FUZZ_SECONDS=60`` makes new ones instead, so long
in each test; a failure then prints the blob that brings it back.
"""

from __future__ import annotations

import functools
import os
import resource
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nimprep.errors import NimprepError
from tests.processes import PATIENCE_S

Result = TypeVar("Result")

SECONDS = float(os.environ.get("NIMPREP_FUZZ_SECONDS", "0"))

TRIED: dict[str, Counter[str]] = {}
"""Per format: how many examples were refused, and how many read."""

EXAMPLE_S = 30
"""Computing of an example that hangs; most take milliseconds. Other work does not count."""

MEMORY = 1 << 30
"""Bytes that the tests here may take beyond what the process had."""


class TimeIsUp(KeyboardInterrupt):
    """Ends a hunt: Hypothesis hands on nothing else at once."""


def fuzz(examples: int, **strategies: st.SearchStrategy[Any]) -> Callable[[Any], Any]:
    """Make a test of so many examples; with NIMPREP_FUZZ_SECONDS, of as many as there is time for.

    Its other arguments are pytest's fixtures, shared by all examples.
    """

    def decorate(check: Callable[..., None]) -> Callable[..., None]:
        end = 0.0

        @functools.wraps(check)
        def example(*args: Any, **named: Any) -> None:
            if SECONDS and time.monotonic() > end:
                raise TimeIsUp
            check(*args, **named)

        test = settings(
            max_examples=1000 if SECONDS else examples,
            derandomize=not SECONDS,
            database=None,
            deadline=None,
            suppress_health_check=list(HealthCheck),
            print_blob=True,
        )(given(**strategies)(example))

        @functools.wraps(test)
        def run(*args: Any, **named: Any) -> None:
            nonlocal end
            end = time.monotonic() + SECONDS
            with suppress(TimeIsUp):
                test(*args, **named)
                # Hypothesis grows slow over a run of very many examples.
                while SECONDS:
                    test(*args, **named)

        return run

    return decorate


def survives(kind: str, read: Callable[[], Result]) -> Result | None:
    """Return what reading gives, or None where it was refused: there is no third way."""
    counts = TRIED.setdefault(kind, Counter())
    with limited_time():
        try:
            result = read()
        except NimprepError as error:
            counts["refused"] += 1
            message = str(error)
            assert "expected" in message, message
            assert "\n" not in message, message
            assert len(message) < 5000, message[:5000]
            return None
    counts["read"] += 1
    return result


@contextmanager
def limited_time(seconds: float = EXAMPLE_S) -> Iterator[None]:
    """Raise an error in what takes longer."""

    def stop(*_: object) -> None:
        raise AssertionError(f"it took more than {seconds} s of computing, or it waits for ever")

    # By the computing of this process; one that waits for ever has another limit.
    limits = {
        signal.SIGPROF: (signal.ITIMER_PROF, seconds),
        signal.SIGALRM: (signal.ITIMER_REAL, PATIENCE_S),
    }
    before = {number: signal.signal(number, stop) for number in limits}
    for timer, limit in limits.values():
        signal.setitimer(timer, limit)
    try:
        yield
    finally:
        for number, (timer, _) in limits.items():
            signal.setitimer(timer, 0)
            signal.signal(number, before[number])


@contextmanager
def limited_memory(extra: int = MEMORY) -> Iterator[None]:
    """Make larger allocations a MemoryError, which is no NimprepError."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + extra, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def report() -> list[str]:
    """Return a line per format: how many examples there were, and what became of them."""
    lines = []
    for kind, counts in sorted(TRIED.items()):
        total = sum(counts.values())
        lines.append(f"{kind}: {total} tried, {counts['refused']} refused, {counts['read']} read")
    total = sum(sum(counts.values()) for counts in TRIED.values())
    return [*lines, f"all: {total} tried, {total} survived"] if lines else []
