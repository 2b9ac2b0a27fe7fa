"""A plugin of the tests: a process that one leaves behind is ended, and the test named.

A process that ends later than its test fails another one, which has nothing to do with it.
"""

from __future__ import annotations

import ctypes
import os
import select
import signal
import sys
from collections.abc import Generator, Iterator
from contextlib import suppress

import pytest

GRACE_S = 60
"""How long a process that a test left may take to end by itself, as one whose pipe was closed."""

_SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER of Linux's prctl

Child = tuple[int, str]
"""A process by its number and when it started, which together are no other's."""


def _read(folder: os.DirEntry[str], name: str) -> str:
    # Most of the processes are nobody's here, and this is done after every test.
    with open(f"{folder.path}/{name}", encoding="utf-8", errors="replace") as file:  # noqa: PTH123
        return file.read()


def _children() -> dict[Child, str]:
    """Return this process's children that live, with their commands; none where no /proc is."""
    if sys.platform != "linux":
        return {}
    try:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return {}  # as after most tests, without a look at every process
    found, own = {}, str(os.getpid())
    for folder in os.scandir("/proc"):
        if not folder.name.isdecimal():
            continue
        with suppress(OSError):  # where it has ended
            fields = _read(folder, "stat").rpartition(")")[2].split()
            state, parent, start = fields[0], fields[1], fields[19]
            if parent == own and state not in "ZX":
                command = _read(folder, "cmdline").replace("\0", " ").strip()
                # Python's own helper of shared memory lives as long as whoever first needed it.
                if "resource_tracker" not in command:
                    found[int(folder.name), start] = command
    return found


def _end_child(child: Child) -> bool:
    """Return whether a child ends by itself, as one whose pipe was closed does; if not, kill it."""
    number, _ = child
    try:
        descriptor = os.pidfd_open(number)
    except ProcessLookupError:
        return True
    try:
        by_itself = bool(select.select([descriptor], [], [], GRACE_S)[0])
        if not by_itself:
            signal.pidfd_send_signal(descriptor, signal.SIGKILL)
        with suppress(ChildProcessError):
            os.waitpid(number, 0)
        return by_itself
    finally:
        os.close(descriptor)


_shared: dict[Child, str] = {}
"""Processes that fixtures of more than one test started, by whom."""


def pytest_configure() -> None:
    """Become the parent of processes whose own parent ends, so that none is out of sight."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(
    fixturedef: pytest.FixtureDef[object], request: pytest.FixtureRequest
) -> Generator[None, object, object]:
    """Note which processes belong to fixtures that outlive a test."""
    before = _children() if fixturedef.scope != "function" else {}
    result = yield
    if fixturedef.scope != "function":
        for child in _children().keys() - before.keys():
            _shared.setdefault(child, f"fixture {fixturedef.argname} of {request.node.nodeid}")
    return result


def _end(left: dict[Child, str]) -> list[str]:
    """End processes; return what those that would not have ended were."""
    return [f"process {child[0]}: {left[child]}" for child in left if not _end_child(child)]


@pytest.fixture(autouse=True)
def _no_process_is_left_by_a_test(request: pytest.FixtureRequest) -> Iterator[None]:
    yield
    left = {child: what for child, what in _children().items() if child not in _shared}
    if said := _end(left):
        pytest.fail(f"{request.node.nodeid} left {'; '.join(said)}", pytrace=False)


@pytest.fixture(autouse=True, scope="session")
def _no_process_is_left_by_a_fixture() -> Iterator[None]:
    yield
    left = {
        child: f"{_shared.get(child, 'the end')}, {what}" for child, what in _children().items()
    }
    if said := _end(left):
        pytest.fail(f"the tests left {'; '.join(said)}", pytrace=False)
