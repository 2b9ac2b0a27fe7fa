"""Read a file that somebody else wrote: a plain file, of a size that can be."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from nimprep.errors import DecodeError, NimprepError

_DONT_WAIT = getattr(os, "O_NONBLOCK", 0)
_PIECE = 1 << 16


@contextmanager
def open_plain(
    path: Path,
    what: str = "a readable file",
    error: type[NimprepError] = DecodeError,
    *,
    pipes: bool = False,
) -> Iterator[tuple[BinaryIO, int]]:
    """Open a file for reading and give it with its size, bytes; links to files are followed.

    Parameters
    ----------
    path : Path
    what : str
        What the file should be, for the message.
    error : class
        What to raise.
    pipes : bool
        Take a pipe or a device too. One within a dataset could keep the reader waiting, or go on,
        for ever; one that the user named is meant.

    Raises
    ------
    NimprepError
        Of the class given: it is missing, unreadable or no plain file.
    """
    # Opening a pipe that nobody writes to would wait as well.
    wait = 0 if pipes else _DONT_WAIT
    try:
        with open(
            path, "rb", buffering=0, opener=lambda name, flags: os.open(name, flags | wait)
        ) as file:
            state = os.fstat(file.fileno())
            if not pipes and not stat.S_ISREG(state.st_mode):
                raise error(f"{path}: expected {what}, found a pipe or a device")
            yield file, state.st_size
    except NimprepError:
        raise
    # A name with a zero byte in it is a ValueError.
    except (OSError, ValueError) as caught:
        reason = getattr(caught, "strerror", None) or caught
        raise error(f"{path}: expected {what}, found {reason}") from caught


def read_file(
    path: Path,
    limit: int,
    what: str = "a readable file",
    error: type[NimprepError] = DecodeError,
    *,
    pipes: bool = False,
) -> bytes:
    """Return a file's bytes; parameters and errors as for `open_plain`.

    A file of more than `limit` bytes is an error too, before it is read.
    """
    parts: list[bytes] = []
    part, total = b"-", 0
    with open_plain(path, what, error, pipes=pipes) as (file, size):
        # Always asked for one byte too many: a pipe does not tell its size, and a file may grow.
        while part and size <= limit and total <= limit and not (parts and total == size):
            part = file.read(min(limit - total, max(size - total, _PIECE)) + 1)
            parts.append(part)
            total += len(part)
    if max(size, total) > limit:
        raise error(f"{path}: expected {what} of at most {limit} bytes, found more")
    return b"".join(parts)


def read_start(path: Path, count: int) -> bytes:
    """Return a file's first bytes, fewer where it has no more; errors as for `open_plain`."""
    with open_plain(path) as (file, _):
        return file.read(count)
