"""Requests after a fork, made by a process of its own.

What makes requests (`nimprep.store.connection`) runs threads, which a fork leaves behind, and waits
for them: a forked process that made a request would wait for ever, and disturb the connections of
the one it came from. PyTorch's DataLoader forks its workers by default. So a forked process starts
a fresh one, asks it over a pipe, and gets bytes back; it ends when the pipe closes.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
from typing import Any

from nimprep.errors import NimprepError, StoreError

_SERVE = (
    "import sys; sys.path[:] = {path!r}; from nimprep.store.request_process import serve; serve()"
)


class RequestProcess:
    """Call a storage's methods in another process, one at a time."""

    def __init__(self) -> None:
        path = [os.path.abspath(p) for p in sys.path]  # noqa: PTH100 - resolving would leave a venv
        self._process = subprocess.Popen(
            [sys.executable, "-c", _SERVE.format(path=path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self._lock = threading.Lock()

    def call(
        self,
        storage: object,
        method: str,
        arguments: tuple[Any, ...],
        named: dict[str, Any],
    ) -> Any:
        """Return what the storage's method returns, or raise what it raises."""
        source, sink = self._process.stdout, self._process.stdin
        assert source is not None
        assert sink is not None
        with self._lock:
            try:
                pickle.dump((storage, method, arguments, named), sink)
                sink.flush()
                value = pickle.load(source)
            except (OSError, EOFError) as error:
                raise StoreError(
                    f"{storage}: expected the process that makes requests to answer, found it gone"
                ) from error
        if isinstance(value, BaseException):
            raise value
        return value


_processes: dict[int, RequestProcess] = {}


def request_process() -> RequestProcess:
    """Return this process's own, started at the first call."""
    # A process forked from this one needs its own: two cannot share a pipe.
    process = os.getpid()
    if process not in _processes:
        _processes[process] = RequestProcess()
    return _processes[process]


def serve() -> None:
    """Answer calls that come by standard input until it closes."""
    import signal

    # Ctrl-C goes to every process of the terminal; who asks decides when to end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    source, sink = sys.stdin.buffer, sys.stdout.buffer
    while True:
        try:
            storage, method, arguments, named = pickle.load(source)
        except EOFError:
            return
        value: Any
        try:
            value = getattr(storage, method)(*arguments, **named)
        except NimprepError as error:
            value = error
        try:
            pickle.dump(value, sink)
            sink.flush()
        except BrokenPipeError:
            os._exit(0)  # who asked is gone; a normal end would try to write the rest
