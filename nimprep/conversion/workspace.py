"""Where a conversion works until its store is whole: beside the target, locked, and resumable."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from filelock import FileLock, Timeout

from nimprep.errors import StoreError
from nimprep.files import replace_file
from nimprep.folders import place_of, sync_tree
from nimprep.store.extras import discard
from nimprep.store.metadata import ROOT
from nimprep.store.storage import LocalStorage, Storage
from nimprep.store.writer import OLD, check_target, move_into_place, put_back

_NOTE = "publishing"
"""Which store is being given its name, while it is."""


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
    task : str
        A part of the folder for what is not a conversion, so that neither takes the other's
        journal for its own; "" = the folder itself.

    Attributes
    ----------
    published : bool
        Whether an earlier run of the task was killed when its store had its name already.
    """

    def __init__(self, target: Path, *, overwrite: bool, task: str = "") -> None:
        self.target = place_of(target)
        self.folder = self.target.with_name(f".{self.target.name}.partial")
        self.place = self.folder / task
        self.store = LocalStorage(self.place / "store")
        self.joined = LocalStorage(self.place / "joined")
        self.journal = LocalStorage(self.place / "journal")
        self.published = False
        self._overwrite = overwrite
        self._grows = task == "append"

    def clear(self) -> None:
        """Remove what an earlier conversion left here."""
        for storage in (self.journal, self.store, self.joined):
            storage.remove("")

    def publish(self, storage: LocalStorage | None = None) -> None:
        """Rename a store into its place, this workspace's `store` if no other is named."""
        storage = storage or self.store
        storage.remove_partial()
        sync_tree(storage.root)
        # Two folders may change names at once; the note tells afterwards which is which.
        note = f"{storage.root.name} {_root_digest(storage.root)}"
        replace_file(self.place / _NOTE, note.encode(), StoreError)
        move_into_place(storage.root, self.target, overwrite=self._overwrite, grows=self._grows)
        shutil.rmtree(self.place, ignore_errors=True)

    def recover(self) -> None:
        """Undo or finish what a kill during `publish` left, of whatever task: no store is lost."""
        for note in (*self.folder.glob(_NOTE), *self.folder.glob(f"*/{_NOTE}")):
            self._recover(note)

    def _recover(self, note: Path) -> None:
        name, _, digest = note.read_text().partition(" ")
        root = note.with_name(name)
        put_back(root, self.target)
        if note.parent == self.place:
            self.published = _root_digest(self.target) == digest
        discard(root.with_suffix(OLD), self.target)
        if _root_digest(root) != digest:
            discard(root, self.target)
        note.unlink()

    def leave(self) -> None:
        """Leave nothing behind but what a later run can go on from."""
        if not self.journal.keys("units"):
            for storage in (self.journal, self.store, self.joined):
                shutil.rmtree(storage.root, ignore_errors=True)
        for folder in (self.place, self.folder):
            if folder.is_dir() and {path.name for path in folder.iterdir()} <= {"lock"}:
                shutil.rmtree(folder, ignore_errors=True)


def _root_digest(store: Path) -> str:
    try:
        return hashlib.sha256((store / ROOT).read_bytes()).hexdigest()
    except OSError:
        return "none"


@contextmanager
def open_workspace(target: Path, *, overwrite: bool, task: str = "") -> Iterator[LocalWorkspace]:
    """Lock the place beside a target for as long as the context lasts, for whatever task.

    The lock goes with the process that holds it, however that ends. Where nothing was done that
    the next run could go on from, nothing is left.

    Raises
    ------
    StoreError
        Another process converts into the target, it must not be replaced, or cannot be written.
    """
    check_target(target, overwrite=overwrite, grows=task == "append")
    workspace = LocalWorkspace(target, overwrite=overwrite, task=task)
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
        workspace.recover()
        check_target(target, overwrite=overwrite, grows=task == "append")
        workspace.store.remove_partial()
        yield workspace
    finally:
        workspace.leave()
        lock.release()
