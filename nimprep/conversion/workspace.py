"""Where a conversion works until its store is whole: beside the target, locked, and resumable."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from filelock import FileLock, Timeout

from nimprep.errors import StoreError
from nimprep.store.storage import LocalStorage, Storage
from nimprep.store.writer import check_target, move_into_place


class Workspace(Protocol):
    """Offer a place for the store and one for the journal, this process's alone.

    Attributes
    ----------
    store : Storage
        Where the store is written.
    journal : Storage
        Where the journal is kept.
    """

    @property
    def store(self) -> Storage: ...

    @property
    def journal(self) -> Storage: ...

    def clear(self) -> None:
        """Remove what an earlier conversion left here."""
        ...

    def publish(self) -> None:
        """Give the finished store its name; nothing else is left behind."""
        ...


class LocalWorkspace:
    """Work in a hidden folder beside the target.

    Parameters
    ----------
    target : Path
        The store's folder.
    overwrite : bool
        Whether a complete store there may be replaced.
    """

    def __init__(self, target: Path, *, overwrite: bool) -> None:
        self.target = target.absolute()
        self.folder = self.target.with_name(f".{self.target.name}.partial")
        self.store = LocalStorage(self.folder / "store")
        self.journal = LocalStorage(self.folder / "journal")
        self._overwrite = overwrite

    def clear(self) -> None:
        """Remove what an earlier conversion left here."""
        for storage in (self.journal, self.store):
            storage.remove("")

    def publish(self) -> None:
        """Rename the store into its place."""
        self.store.remove_partial()
        _sync_files(self.store.root)
        move_into_place(self.store.root, self.target, overwrite=self._overwrite)
        shutil.rmtree(self.folder, ignore_errors=True)


@contextmanager
def open_workspace(target: Path, *, overwrite: bool) -> Iterator[LocalWorkspace]:
    """Lock the place beside a target for as long as the context lasts.

    The lock goes with the process that holds it, however that ends. Where nothing was done that
    the next run could go on from, nothing is left.

    Raises
    ------
    StoreError
        Another process converts into the target, it must not be replaced, or cannot be written.
    """
    check_target(target, overwrite=overwrite)
    workspace = LocalWorkspace(target, overwrite=overwrite)
    lock = FileLock(workspace.folder / "lock")
    try:
        workspace.folder.mkdir(parents=True, exist_ok=True)
        lock.acquire(blocking=False)
        # Whoever held it until a moment ago may have finished and removed the folder.
        held = (workspace.folder / "lock").exists()
    except (Timeout, FileNotFoundError):
        held = False
    except OSError as error:
        raise StoreError(f"{target}: expected a writable place, found {error.strerror}") from error
    if not held:
        raise StoreError(
            f"{target}: expected no other conversion into it, found one at work; wait for it, or "
            "choose another name"
        )
    try:
        workspace.store.remove_partial()
        yield workspace
    finally:
        if not workspace.journal.keys("units"):
            shutil.rmtree(workspace.folder, ignore_errors=True)
        lock.release()


def _sync_files(folder: Path) -> None:
    """Put every file on the disk: a power failure after the renaming must not empty one."""
    for path in folder.rglob("*"):
        if path.is_file():
            descriptor = os.open(path, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
