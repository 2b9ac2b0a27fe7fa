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
from pathlib import Path

import pytest

GRACE_S = 60
"""How long a process that a test left may take to end by itself, as one whose pipe was closed."""

_SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER of Linux's prctl

Child = tuple[int, str]
"""A process by its number and when it started, which together are no other's."""


def _children() -> dict[Child, str]:
    """Return this process's children that live, with their commands; none where no /proc is."""
    if sys.platform != "linux":
        return {}
    try:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return {}  # as after most tests, without a look at every process
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            command = (
                (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            )
        except OSError:
            continue  # it has ended
        state, parent, start = fields[0], int(fields[1]), fields[19]
        # Python's own helper of shared memory lives as long as the process that first needed it.
        if parent == os.getpid() and state not in "ZX" and "resource_tracker" not in command:
            found[int(folder.name), start] = command.strip()
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
