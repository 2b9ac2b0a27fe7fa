"""Converting into an object store, where nothing can be renamed.

The store's keys are written in their final place, and the journal and the lock below a hidden name
beside it: s3://bucket/.out.zarr.partial for s3://bucket/out.zarr. The root says that the store is
not complete until everything else is there, so that nobody reads half of one. A store that is
replaced is lost from the first write on: its root is marked as not complete, its other keys go, and
then the new ones come. Keys that are not nimprep's stay; where there are any, nothing is replaced.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress

from nimprep.conversion.journal import PLAN
from nimprep.errors import StoreError
from nimprep.schema import json_bytes
from nimprep.store.connection import RequestError
from nimprep.store.extras import check_replaceable, is_own, own_arrays
from nimprep.store.lock import hidden_objects, locked_objects
from nimprep.store.metadata import ROOT, read_attributes, read_document
from nimprep.store.object_lock import ObjectLock
from nimprep.store.objects import ObjectStorage


class ObjectWorkspace:
    """Work in the final place, with the journal beside it.

    Parameters
    ----------
    target : ObjectStorage
        The store.
    hidden : ObjectStorage
        Where the journal is.
    lock : ObjectLock
        Held; made sure of before every write.
    """

    def __init__(self, target: ObjectStorage, hidden: ObjectStorage, lock: ObjectLock) -> None:
        self.where = str(target)
        self.store = target
        self.journal = hidden.sibling(f"{hidden.name}/journal")
        self._lock = lock
        self._stale = False
        self._published = False
        for storage in (self.store, self.journal):
            storage.before_write = self._before_write

    def clear(self) -> None:
        """Have what an earlier conversion left here removed, before anything is written."""
        self._stale = True

    def _before_write(self) -> None:
        self._lock.check()
        if self._stale:
            # A plan in the journal tells that this was done, so it must be done before.
            self._stale = False
            self.journal.remove("")
            self._empty()

    def _empty(self) -> None:
        """Remove the store's own keys; until the last its root says that it is not complete."""
        if self.store.read(ROOT) is None:
            return
        root = read_document(self.store, ROOT)
        attributes = root["attributes"]["nimprep"]
        attributes["complete"] = False
        self.store.write(ROOT, [json_bytes(root)])
        arrays = own_arrays(attributes)
        there = self.store.keys()
        keys = [key for key in there if is_own(key, arrays)]
        self.store.remove_each([key for key in keys if key != ROOT])
        self.store.remove_each([ROOT])

    def publish(self) -> None:
        """Remove the journal: the store has its name already, and is complete."""
        self._published = True
        self.journal.remove("")

    def leave(self) -> None:
        """Leave nothing behind but what a later run can go on from."""
        if self._published or self.journal.keys("units"):
            return
        # What was there before stays, where nothing was written yet.
        if not self._stale and not _is_complete(self.store):
            self._empty()
        self._stale = False
        self.journal.remove("")


@contextmanager
def open_object_workspace(target: ObjectStorage, *, overwrite: bool) -> Iterator[ObjectWorkspace]:
    """Lock a store's place and the hidden one beside it for as long as the context lasts.

    Raises
    ------
    StoreError
        Another process converts into the target, it must not be replaced, or cannot be written.
    """
    if not target.name:
        raise StoreError(
            f"{target}: expected a name for the store in the bucket, such as "
            f"{target}/out.zarr, found none; add one"
        )
    hidden = hidden_objects(target)
    with locked_objects(target) as lock:
        complete = _check_target(target)
        workspace = ObjectWorkspace(target, hidden, lock)
        try:
            _clear_old(workspace, complete=complete, overwrite=overwrite)
            try:
                yield workspace
            except RequestError:
                raise  # cleaning up would fail as well, each request after a minute
            except BaseException:
                with suppress(RequestError):
                    workspace.leave()
                raise
            workspace.leave()
        finally:
            # The storages and what they ask hold each other, and connections with them.
            for storage in (workspace.store, workspace.journal):
                storage.before_write = None


def _clear_old(workspace: ObjectWorkspace, *, complete: bool, overwrite: bool) -> None:
    """Forget what is kept of an earlier conversion, where a complete store is in the place."""
    if not complete:
        return
    target = workspace.store
    # What is kept is of a conversion that had its end, or of another store. The plan by its
    # name: of what a listing leaves out nothing counts without it.
    if workspace.journal.read(PLAN) is not None:
        workspace.journal.remove(PLAN)
    workspace.journal.remove("")
    if not overwrite:
        raise StoreError(
            f"{target}: expected a free name for the store, found a complete store; "
            "use --overwrite to replace it"
        )
    check_replaceable(target)


def _check_target(target: ObjectStorage) -> bool:
    """Return whether there is a complete store; raise `StoreError` where is something else."""
    if target.read(ROOT) is None and not target.has_keys():
        return False
    try:
        return read_attributes(target, complete=False).get("complete") is True
    except StoreError as error:
        raise StoreError(
            f"{target}: expected a free name for the store, found keys that are no nimprep "
            "store; choose another name"
        ) from error


def _is_complete(target: ObjectStorage) -> bool:
    return target.read(ROOT) is not None and _check_target(target)
