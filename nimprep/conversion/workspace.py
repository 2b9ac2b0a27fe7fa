"""Where a conversion works until its store is whole: beside the target, locked, and resumable."""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from nimprep.conversion.object_workspace import ObjectWorkspace, open_object_workspace
from nimprep.errors import StoreError
from nimprep.files import replace_file
from nimprep.folders import place_of, sync_tree
from nimprep.store.extras import discard
from nimprep.store.location import location_from
from nimprep.store.lock import LOCK, MARKER, hidden_folder, locked_folder
from nimprep.store.metadata import ROOT
from nimprep.store.objects import ObjectStorage
from nimprep.store.storage import LocalStorage
from nimprep.store.writer import OLD, check_target, move_into_place, put_back

_NOTE = "publishing"
"""Which store is being given its name, while it is."""

_NOTE_FORM = re.compile(r"(store|joined) ([0-9a-f]{64})")


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
    store, joined, journal : LocalStorage
        Where the store is written, where one put together with another is, and the journal's place.
    where : str
        The target as it was named.
    published : bool
        Whether an earlier run of the task was killed when its store had its name already.
    """

    def __init__(self, target: Path, *, overwrite: bool, task: str = "") -> None:
        self.where = str(target)
        self.target = place_of(target)
        self.folder = hidden_folder(self.target)
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
        note = f"{storage.root.name} {root_digest(storage.root)}"
        replace_file(self.place / _NOTE, note.encode(), StoreError)
        move_into_place(storage.root, self.target, overwrite=self._overwrite, grows=self._grows)
        self._discard()

    def _discard(self) -> None:
        """Remove what was worked with; as long as the note is there, nobody goes on from it."""
        # The lock stays: the next one at work here must not have its files removed by this one.
        last = (self.journal.root.name, _NOTE)
        others = {path.name for path in self.place.iterdir()} - {LOCK, MARKER, *last}
        for path in (self.place / name for name in (*sorted(others), *last)):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)

    def recover(self) -> None:
        """Undo or finish what a kill during `publish` left, of whatever task: no store is lost."""
        for note in (*self.folder.glob(_NOTE), *self.folder.glob(f"*/{_NOTE}")):
            self._recover(note)

    def _recover(self, note: Path) -> None:
        names = (self.store.root.name, self.joined.root.name)
        said = _NOTE_FORM.fullmatch(note.read_bytes().decode(errors="replace"))
        for name in (said[1],) if said else names:
            root = note.with_name(name)
            put_back(root, self.target)
            discard(root.with_suffix(OLD), self.target)
            # Of a note that a fault spoilt nobody knows which of two stores is the new one; that at
            # the target is whole, and the other can be made again.
            if said is None or root_digest(root) != said[2]:
                discard(root, self.target)
        if said is None:
            shutil.rmtree(note.with_name(self.journal.root.name), ignore_errors=True)
        elif note.parent == self.place:
            self.published = root_digest(self.target) == said[2]
        note.unlink()

    def leave(self) -> None:
        """Leave nothing behind but what a later run can go on from."""
        if not self.journal.keys("units"):
            for storage in (self.journal, self.store, self.joined):
                shutil.rmtree(storage.root, ignore_errors=True)
        if self.place != self.folder and self.place.is_dir() and not any(self.place.iterdir()):
            self.place.rmdir()


Workspace = LocalWorkspace | ObjectWorkspace


def workspace_at(
    storage: LocalStorage | ObjectStorage, *, overwrite: bool
) -> AbstractContextManager[Workspace]:
    """Return the context of a place to convert in, wherever the target is."""
    if storage.root is not None:
        return open_workspace(storage.root, overwrite=overwrite)
    return open_object_workspace(storage, overwrite=overwrite)


def check_apart(source: Path, target: Path) -> None:
    """Raise `StoreError` where writing the target would write into the source."""
    a, b = source.resolve(), target.resolve()
    if a == b or b.is_relative_to(a) or a.is_relative_to(b):
        raise StoreError(
            f"{target}: expected a target apart from the source {source}, found one within the "
            "other; choose another place"
        )


def local_folder(place: Path | str, task: str) -> Path:
    """Return the folder of a store.

    Parameters
    ----------
    task : str
        What it is needed for, for the message.

    Raises
    ------
    StoreError
        It is a URL.
    """
    found = location_from(place)
    if isinstance(found, str):
        raise StoreError(
            f"{place}: expected a folder on this machine to {task}, found a URL; copy the store "
            "here first"
        )
    return found


def root_digest(store: Path) -> str:
    """Return what tells one state of a store from another: the digest of its root."""
    try:
        return hashlib.sha256((store / ROOT).read_bytes()).hexdigest()
    except OSError:
        return "none"


def check_unchanged(store: Path, digest: str) -> None:
    """Make sure that a store is what it was when it was opened, and had this digest.

    Every command of this program that changes a store keeps out whoever else would; others do not.

    Raises
    ------
    StoreError
        It is not.
    """
    if root_digest(store) != digest:
        raise StoreError(
            f"{store}: expected a store that stays as it is meanwhile, found that it was changed; "
            "nothing was written to it, give the same command again"
        )


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
    grows = task == "append"
    check_target(target, overwrite=overwrite, grows=grows)
    with locked_folder(target):
        workspace = LocalWorkspace(target, overwrite=overwrite, task=task)
        try:
            workspace.recover()
            check_target(target, overwrite=overwrite, grows=grows)
            workspace.store.remove_partial()
            yield workspace
        finally:
            workspace.leave()
