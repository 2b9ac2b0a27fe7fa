"""Folders: filled whole or not at all, over nothing unasked, and never within what is only read.

Single files: see `nimprep.files`.
"""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from nimprep.errors import LayoutError, NimprepError

PARTIAL = ".partial"
"""Ends the hidden names of what is not whole yet."""

_MAX_ROOT = 1 << 25
"""Bytes of a zarr.json that are looked at."""


def place_of(path: Path) -> Path:
    """Return a path that stays right wherever the process goes: absolute, without "." and "..".

    Links above it are followed; one that it is itself stays, unless its name is no name.
    """
    if path.name in ("", ".."):
        return Path(os.path.realpath(path))
    return Path(os.path.realpath(path.parent), path.name)


def refuse_inside(out: Path, *sources: Path, error: type[NimprepError] = LayoutError) -> None:
    """Raise `error` where `out` lies in one of the sources or in any store: they are left alone.

    Links are followed, those above `out` and the one that it may be.
    """
    places = {Path(os.path.realpath(out)), place_of(out)}
    for source in sources:
        if any(place.is_relative_to(os.path.realpath(source)) for place in places):
            raise error(
                f"{out}: expected a place outside the source {source}, found one in it; "
                "sources are never written to"
            )
    for folder in {folder for place in places for folder in place.parents}:
        if _is_store(folder):
            raise error(
                f"{out}: expected a place outside of stores, found one in {folder}; choose another"
            )


def _is_store(folder: Path) -> bool:
    root = folder / "zarr.json"
    try:
        if not root.is_file():
            return False
        with root.open("rb") as file:
            return b'"nimprep"' in file.read(_MAX_ROOT)
    except OSError:
        return False


def check_folder(
    out: Path, *sources: Path, but: Path | None = None, error: type[NimprepError] = LayoutError
) -> None:
    """Refuse a place where a folder must not be filled.

    Parameters
    ----------
    out : Path
    *sources : Path
        What is read; nothing is ever written into it.
    but : Path, optional
        Does not count.
    error : class
        What to raise.

    Raises
    ------
    NimprepError
        Of the class given: it is neither a new name nor an empty folder, or lies in a source or in
        a store.
    """
    with told(out, error):
        refuse_inside(out, *sources, error=error)
        if out.is_symlink() or (out.exists() and not out.is_dir()):
            raise error(
                f"{out}: expected a new or empty folder, found a file or link; choose another"
            )
        names = [path.name for path in out.iterdir() if path != but] if out.is_dir() else []
        if names:
            raise error(
                f"{out}: expected a new or empty folder, found {min(names)!r} in it; choose "
                "another or empty it"
            )


@contextmanager
def whole_folder(
    out: Path, *sources: Path, error: type[NimprepError] = LayoutError
) -> Iterator[Path]:
    """Give a hidden folder to fill; what is in it is at `out` when the context ends well.

    A new folder gets its name at once. An empty one that was there is kept, as somebody may be in
    it, and what is in the hidden one moves up, in the order of the names. After an error nothing
    is left. At the end all of it is on the disk.

    Parameters and errors are those of `check_folder`; where it cannot be written is one more.
    """
    check_folder(out, *sources, error=error)
    with told(out, error):
        target = place_of(out)
        there = target.is_dir()
        parent = target if there else target.parent
        with made(parent), _hidden(parent) as partial:
            yield partial
            sync_tree(partial)
            check_folder(target, *sources, but=partial, error=error)
            for path in sorted(partial.iterdir()) if there else ():
                path.rename(target / path.name)
            if not there:
                partial.rename(target)
            sync_folder(parent)


@contextmanager
def made(folder: Path) -> Iterator[None]:
    """Make a folder and those above it; after an error take back what is new and empty."""
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder)) from error
    try:
        yield
    except BaseException:
        with suppress(OSError):
            for path in new:
                path.rmdir()
        raise


@contextmanager
def _hidden(parent: Path) -> Iterator[Path]:
    """Give a hidden folder in another; what is left of it at the end goes."""
    partial = parent / hidden_name()
    try:
        partial.mkdir()
        yield partial
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def hidden_name() -> str:
    """Return a name that nobody else has, for what is not whole yet."""
    return f".{secrets.token_hex(8)}{PARTIAL}"


@contextmanager
def told(out: Path, error: type[NimprepError]) -> Iterator[None]:
    """Let a fault of the disk be an `error` of one line."""
    try:
        yield
    except NimprepError:
        raise
    # A name with a zero byte in it is a ValueError.
    except (OSError, ValueError) as caught:
        reason = getattr(caught, "strerror", None) or caught
        raise error(f"{out}: expected to write it, found {reason}") from caught


def link_tree(path: Path, other: Path, error: type[NimprepError] = LayoutError) -> None:
    """Give a file, or all that is in a folder, a second name; links stay links.

    Raises
    ------
    NimprepError
        Of the class given: it cannot be written.
    """
    with told(other, error):
        if path.is_symlink():
            other.parent.mkdir(parents=True, exist_ok=True)
            other.symlink_to(path.readlink())
        elif path.is_dir():
            other.mkdir(parents=True)
            for inner in path.iterdir():
                link_tree(inner, other / inner.name, error)
            shutil.copystat(path, other)
            adopt(other, path.stat())
        else:
            link_or_copy(path, other, error)


def link_or_copy(path: Path, other: Path, error: type[NimprepError] = LayoutError) -> None:
    """Give a file a second name; where the file system has none to give, copy it, times and all.

    Errors are those of `link_tree`.
    """
    with told(other, error):
        other.parent.mkdir(parents=True, exist_ok=True)
        try:
            other.hardlink_to(path)
        except OSError:
            if not path.is_file():
                raise  # a pipe would be waited for
            shutil.copy2(path, other)
            adopt(other, path.stat())


def adopt(path: Path, before: os.stat_result, least: int = 0) -> None:
    """Give a file or folder the owner, where that is allowed, and the mode of what it replaces.

    Parameters
    ----------
    least : int
        Bits of the mode that it has in any case.
    """
    now = path.stat()
    if (now.st_uid, now.st_gid) != (before.st_uid, before.st_gid):
        with suppress(OSError, AttributeError):
            os.chown(path, before.st_uid, before.st_gid)
    mode = stat.S_IMODE(before.st_mode) | least
    if stat.S_IMODE(path.stat().st_mode) != mode:
        with suppress(OSError):
            path.chmod(mode)


def adopt_tree(folder: Path, before: Path) -> None:
    """Give a folder, and all in it, owners and modes as in the folder that it is to replace.

    What has no counterpart there gets the folder's own owner. Folders can be written by their
    owner in any case, so that they can be moved and removed.
    """
    home = before.stat()
    foreign = os.name == "posix" and (home.st_uid, home.st_gid) != (os.getuid(), os.getgid())
    for path, _, names in os.walk(folder):
        for place in (Path(path), *(Path(path, name) for name in names)):
            if place.is_symlink():
                continue
            least = stat.S_IRWXU if place.is_dir() else 0
            other = before / place.relative_to(folder)
            if other.exists() and other.is_dir() == place.is_dir():
                adopt(place, other.stat(), least)
            elif foreign:
                with suppress(OSError):
                    os.chown(place, home.st_uid, home.st_gid)


def refuse_within(folder: Path, error: type[NimprepError] = LayoutError) -> None:
    """Raise `error` where this process works in a folder that is about to be replaced.

    It, and the shell that it was called from, would be left in one that is gone.
    """
    try:
        here = Path.cwd()
    except FileNotFoundError:
        return  # gone already
    if here.is_relative_to(os.path.realpath(folder)):
        raise error(
            f"{folder}: expected to be called from outside of the folder that is replaced, found "
            f"the working directory {here}; change to another first"
        )


def sync_tree(folder: Path) -> None:
    """Put every file and folder below on the disk, and the folder itself; links are not followed.

    Done before a folder gets its name, so that a power failure afterwards does not empty a file.
    """
    for path, _, names in os.walk(folder):
        for name in names:
            file = Path(path, name)
            if file.is_file() and not file.is_symlink():
                sync_file(file)
        sync_folder(Path(path))


def sync_folder(folder: Path) -> None:
    """Make the names in a folder last; systems that cannot open folders do so by themselves."""
    if os.name == "posix":
        sync_file(folder)


_CANNOT_SYNC = {errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP}
"""What network and FUSE file systems answer that do not sync files, or folders: no fault."""


def sync_file(path: Path) -> None:
    """Put what a file holds on the disk, where its file system has a way to."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _CANNOT_SYNC:
            raise
    finally:
        os.close(descriptor)
