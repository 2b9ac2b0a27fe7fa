"""A clock that only goes on while somebody sleeps: half a minute's wait takes no time."""

from __future__ import annotations

import time
from collections.abc import Callable


class Clock:
    """Stand in for the module `time`.

    Attributes
    ----------
    slept_s : float
        How long all that slept have slept.
    while_asleep : callable
        Called whenever somebody sleeps: what others do meanwhile.
    """

    def __init__(self) -> None:
        self.slept_s = 0.0
        self._start = time.time()
        self.while_asleep: Callable[[], object] = lambda: None

    def monotonic(self) -> float:
        """Return seconds since some moment."""
        return self.slept_s

    def time(self) -> float:
        """Return seconds since 1970."""
        return self._start + self.slept_s

    def sleep(self, seconds: float) -> None:
        """Set the clock forward."""
        self.slept_s += seconds
        self.while_asleep()
