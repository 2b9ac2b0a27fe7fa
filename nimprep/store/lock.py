"""One command at a time changes a store, on a disk and in an object store.

The lock lies beside the store, in the hidden place where conversions work: `.out.zarr.partial/lock`
for `out.zarr`. On a disk it goes with the process that holds it, however that ends; on file systems
that have no locks a file stands for it (`MARKER`), which outlives a process that is killed. Of
object stores see `nimprep.store.object_lock`.
"""

from __future__ import annotations

import errno
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from filelock import FileLock, SoftFileLock, Timeout

from nimprep.errors import StoreError
from nimprep.folders import place_of
from nimprep.store.access import storage_from
from nimprep.store.location import Place
from nimprep.store.metadata import read_attributes
from nimprep.store.object_lock import ObjectLock
from nimprep.store.objects import ObjectStorage
from nimprep.store.storage import LocalStorage, Storage

LOCK = "lock"

MARKER = "lock.held"
"""There while a process holds the lock of a store whose file system has none."""

_WITHOUT_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP}
"""What NFS without its lock daemon, Lustre without -o flock and some FUSE file systems answer."""

_MOMENT_S = 0.3
"""Time enough to find that whoever left a marker is gone, and to put another in its place."""


@contextmanager
def changing(place: Place | Storage) -> Iterator[LocalStorage | ObjectStorage]:
    """Keep a store from being changed by anybody else for as long as the context lasts.

    Every command that changes a store where it is does so in here, and reads what it depends on in
    here too.

    Raises
    ------
    StoreError
        There is no complete store, somebody else changes it, or it cannot be written.
    """
    storage = storage_from(place)
    # First of all, so that nothing is made beside what is no store.
    read_attributes(storage)
    if storage.root is not None:
        root = storage.root
        # Whoever comes by another name, a link, must find the same lock.
        with locked_folder(root.resolve() if root.is_symlink() else root):
            yield storage
        return
    before = storage.before_write
    with locked_objects(storage) as lock:
        storage.before_write = lock.check
        try:
            yield storage
        finally:
            storage.before_write = before


def hidden_folder(target: Path) -> Path:
    """Return where a store's lock is, and where conversions into it work."""
    target = place_of(target)
    return target.with_name(f".{target.name}.partial")


def hidden_objects(target: ObjectStorage) -> ObjectStorage:
    """Return where a store's lock and a conversion's journal are."""
    return target.sibling(f".{target.name}.partial")


def locked_objects(target: ObjectStorage) -> ObjectLock:
    """Return the context in which nobody else changes a store at a URL."""
    return ObjectLock(hidden_objects(target), LOCK, str(target))


@contextmanager
def locked_folder(target: Path) -> Iterator[Path]:
    """Let nobody else change a store in a folder for as long as the context lasts.

    Gives the hidden folder beside it, which goes at the end if nothing else is left in it.

    Raises
    ------
    StoreError
        Somebody else changes it, or nothing can be written beside it.
    """
    folder = hidden_folder(target)
    with ExitStack() as held:
        held.callback(_remove_empty, folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _take(folder, target, held)
            # Whoever held it until a moment ago may have removed the folder.
            there = (folder / LOCK).exists()
        except (Timeout, FileNotFoundError):
            there = False
        except OSError as error:
            raise StoreError(
                f"{target}: expected a writable place, found {error.strerror}"
            ) from error
        if not there:
            raise StoreError(
                f"{target}: expected nobody else to change it, found one at work{_holder(folder)}"
            )
        try:
            yield folder
        finally:
            with suppress(OSError):
                if {path.name for path in folder.iterdir()} <= {LOCK, MARKER}:
                    # While it is held, so that nobody can have taken it since.
                    (folder / LOCK).unlink()


def _take(folder: Path, target: Path, held: ExitStack) -> None:
    """Acquire the lock, or raise `Timeout` at once; `held` releases it."""
    lock = FileLock(folder / LOCK, fallback_to_soft=False)
    try:
        held.enter_context(lock.acquire(blocking=False))
        if not (folder / MARKER).exists():
            return
    except OSError as error:
        if error.errno not in _WITHOUT_LOCKS:
            raise
        warnings.warn(
            f"{target}: its file system has no locks ({error.strerror}); the file "
            f"{folder / MARKER} stands for one meanwhile, to be deleted if a crash leaves it",
            stacklevel=6,
        )
    # Also of who has a lock: another machine, or a moment ago this one, may not have had any.
    marker = SoftFileLock(folder / MARKER)
    held.enter_context(marker.acquire(timeout=_MOMENT_S, poll_interval=_MOMENT_S / 3))


def _holder(folder: Path) -> str:
    """Return what to do about a lock that is held, and by whom as far as it says."""
    try:
        process, host = (folder / MARKER).read_text()[:200].split("\n")[:2]
        who = f", process {int(process)} on {host}" if host and host.isprintable() else ""
    except FileNotFoundError:
        return "; wait for it, or choose another name"
    except (OSError, ValueError):
        who = ""
    return f"{who}; wait for it, or delete {folder / MARKER} if it has ended"


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()
