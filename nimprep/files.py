"""Files: read where they are plain and of a size that can be; written whole, over nothing unasked.

`whole_file` and `write_whole` write what a user named, `replace_file` what is nimprep's own, such
as a store's parts. Whole folders: see `nimprep.folders`.
"""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from nimprep.errors import DecodeError, LayoutError, NimprepError
from nimprep.folders import (
    adopt,
    hidden_name,
    made,
    place_of,
    refuse_inside,
    sync_file,
    sync_folder,
    told,
)

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


def check_file(
    out: Path, *sources: Path, overwrite: bool = False, error: type[NimprepError] = LayoutError
) -> None:
    """Refuse, before any work is done, a file that must not be written.

    Parameters
    ----------
    out : Path
    *sources : Path
        What is read; nothing is ever written into it.
    overwrite : bool
        A file, or a link to one, may be there. It is replaced, and what a link led to stays.
    error : class
        What to raise.

    Raises
    ------
    NimprepError
        Of the class given: it lies in a source or in a store, is a folder, or is there already.
    """
    with told(out, error):
        refuse_inside(out, *sources, error=error)
        _replaced(out, overwrite, error)


@contextmanager
def whole_file(
    out: Path, *sources: Path, overwrite: bool = False, error: type[NimprepError] = LayoutError
) -> Iterator[Path]:
    """Give a path beside `out` to write to; the file gets its name when the context ends well.

    Until then what is there stays, and after an error there is nothing else. At the end the file is
    on the disk: a power failure does not take it back. One that is replaced hands on its mode and,
    where that is allowed, its owner. A pipe or a terminal, which a user may name too, is written to
    at the end.

    Parameters and errors are those of `check_file`; where it cannot be written is one more.
    """
    check_file(out, *sources, overwrite=overwrite, error=error)
    with told(out, error):
        if _is_stream(out):
            with tempfile.TemporaryDirectory() as folder:
                yield Path(folder, "whole")
                with Path(folder, "whole").open("rb") as file, out.open("wb") as stream:
                    shutil.copyfileobj(file, stream)
            return
        target = place_of(out)
        with _beside(target) as partial:
            yield partial
            before = _replaced(out, overwrite, error)
            _settle(partial, before)
            if overwrite:
                partial.replace(target)
            else:
                _give_new_name(partial, target, error)


def write_whole(
    out: Path,
    data: bytes | Sequence[bytes],
    *sources: Path,
    overwrite: bool = False,
    error: type[NimprepError] = LayoutError,
) -> None:
    """Write a file from its bytes, or the parts of them, as `whole_file` does."""
    with whole_file(out, *sources, overwrite=overwrite, error=error) as path:
        _write(path, data)


def replace_file(
    path: Path, data: bytes | Sequence[bytes], error: type[NimprepError] = LayoutError
) -> None:
    """Write a file of nimprep's own, whatever is there: whole or not at all, and on the disk.

    Raises
    ------
    NimprepError
        Of the class given: it cannot be written.
    """
    with told(path, error), _beside(path) as partial:
        _write(partial, data)
        _settle(partial, _state(path))
        partial.replace(path)


@contextmanager
def _beside(target: Path) -> Iterator[Path]:
    """Give a hidden name in the same folder, which is made as needed; keep the change of names."""
    partial = target.with_name(hidden_name())
    with made(target.parent):
        try:
            yield partial
        except BaseException:
            partial.unlink(missing_ok=True)
            raise
        sync_folder(target.parent)


def _write(path: Path, data: bytes | Sequence[bytes]) -> None:
    with path.open("wb") as file:
        file.writelines([data] if isinstance(data, bytes) else data)


def _state(path: Path) -> os.stat_result | None:
    """Return the state of what a path leads to; None = nothing."""
    try:
        return path.stat()
    except FileNotFoundError:
        return None


def _is_stream(out: Path) -> bool:
    """Return whether it is a pipe or a character device: there is nothing to overwrite."""
    state = _state(out)
    return state is not None and (stat.S_ISFIFO(state.st_mode) or stat.S_ISCHR(state.st_mode))


def _replaced(out: Path, overwrite: bool, error: type[NimprepError]) -> os.stat_result | None:
    """Return the state of what is to be replaced, None = nothing; raise where it must stay."""
    state = _state(out)
    if state is not None and stat.S_ISDIR(state.st_mode):
        raise error(f"{out}: expected a file to write, found a folder; name a file in it")
    if _is_stream(out):
        return state
    if state is not None and not stat.S_ISREG(state.st_mode):
        raise error(f"{out}: expected a file to write, found a device or a socket; name another")
    link = out.is_symlink()
    if link and str(out.readlink()).startswith("/proc/"):
        # Such as /dev/stdout: the link itself must never be replaced.
        raise error(f"{out}: expected a file to write, found a link to an open one; name that one")
    if not overwrite and (link or state is not None):
        raise error(f"{out}: expected a new file, found one there already; --overwrite replaces it")
    return state


def _settle(partial: Path, before: os.stat_result | None) -> None:
    """Put a finished file on the disk, with the mode of what it replaces."""
    sync_file(partial)
    if before is not None:
        adopt(partial, before)


def _give_new_name(partial: Path, target: Path, error: type[NimprepError]) -> None:
    """Move a file to where nothing is; what has come there since stays."""
    try:
        target.hardlink_to(partial)
    except OSError:
        # It is there, or the file system knows no second names.
        _replaced(target, False, error)
        partial.replace(target)
    else:
        partial.unlink()
