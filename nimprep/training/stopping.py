"""Being asked to stop: a training ends between two steps, and what it has is kept."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from nimprep.torch.ranks import ranks

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""Ctrl-C, and what a queue sends before it kills."""


class Asked(KeyboardInterrupt):
    """Somebody asked to stop, between two steps."""


class Stop:
    """Tell whether somebody asked to stop."""

    def __init__(self) -> None:
        self.asked = False

    def check(self) -> None:
        """Raise `Asked` where somebody asked."""
        if self.asked:
            raise Asked


@contextmanager
def stopping() -> Iterator[Stop]:
    """Give what tells whether the process was sent SIGINT or SIGTERM in the context.

    A second one ends it at once. Of several processes, which must not part between two steps, and
    outside the main thread, which signals do not reach, the first does.
    """
    stop = Stop()
    if ranks()[1] > 1 or threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.getsignal(number) for number in _SIGNALS}

    def ask(number: int, frame: FrameType | None) -> None:
        if stop.asked:
            raise KeyboardInterrupt
        stop.asked = True

    # Who ignores a signal has a reason, a shell's background say.
    heard = [n for n, handler in before.items() if handler not in (signal.SIG_IGN, None)]
    for number in heard:
        signal.signal(number, ask)
    try:
        yield stop
    finally:
        for number in heard:
            handler: Any = before[number]
            signal.signal(number, handler)
