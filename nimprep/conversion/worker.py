"""What goes to a cluster's worker, and what it does with it."""

from __future__ import annotations

import hashlib
import pickle
import threading
import zlib
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from nimprep.conversion.encode import encode_unit
from nimprep.conversion.plan import Job
from nimprep.errors import NimprepError, StoreError
from nimprep.readers import Reader
from nimprep.store.metadata import ROOT

Reply = tuple[str, bytes]
"""What a task returns: "record", "error" or "version", and the bytes of it.

Bytes, so that the scheduler never needs nimprep to pass it on.
"""


def packed(job: Job, run: str) -> bytes:
    """Return what a worker needs to know; `run` tells conversions apart that are alike."""
    return zlib.compress(pickle.dumps((run, _portable(job), _root_digest(job))), 1)


def _portable(job: Job) -> Job:
    """Return the job with paths that hold in whatever folder a worker runs."""
    files: dict[str, Any] = {
        name: Path(value).absolute()
        for name in ("camera", "description")
        if isinstance(value := getattr(job.options, name), (str, Path))
    }
    return replace(job, source=job.source.absolute(), options=replace(job.options, **files))


def _root_digest(job: Job) -> bytes:
    return hashlib.sha256(job.storage.read(ROOT) or b"").digest()


_OPENING = threading.Lock()


@lru_cache(maxsize=4)
def _opened(data: bytes) -> tuple[Job, Reader, bytes]:
    _, job, root = pickle.loads(zlib.decompress(data))
    _check_root(job, root)
    return job, job.open_reader(), root


def _check_root(job: Job, root: bytes) -> None:
    """Make sure that the target is the one the job was planned for, and still at work on it.

    A task may outlive the conversion that submitted it; it must not write into the next one.
    """
    if _root_digest(job) != root:
        raise StoreError(
            f"{job.storage}: expected the store being converted, found it not there; workers must "
            "see the same folders"
        )


def encode_unit_of(data: bytes, number: int) -> Reply:
    """Encode and write one unit, on a worker; the source is opened once per process."""
    from distributed import get_worker

    try:
        with _OPENING:
            job, reader, root = _opened(data)
        record = encode_unit(job, reader, number, lambda: _check_root(job, root))
    except NimprepError as error:
        if error.frame_id is None or isinstance(error.__cause__, OSError):
            error.add_note(
                f"on worker {get_worker().address}: source and target must be in reach of every "
                "worker, under the same paths"
            )
        # A file system's fault may be this worker's alone: raised, Dask tries again.
        if isinstance(error.__cause__, OSError):
            raise
        return "error", pickle.dumps(error)
    return "record", record.to_json()
