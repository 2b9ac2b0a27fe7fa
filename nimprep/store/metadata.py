"""A store's JSON documents: written whole or not at all; doubts in reading are `StoreError`s."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nimprep.errors import StoreError
from nimprep.store.spec import check_version

ROOT = "zarr.json"


def read_document(path: Path) -> dict[str, Any]:
    """Read a zarr.json.

    Raises
    ------
    StoreError
        It is missing, unreadable or no JSON object.
    """
    try:
        document = json.loads(path.read_bytes())
    except OSError as error:
        raise StoreError(f"{path}: expected a readable file, found {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise StoreError(f"{path}: expected JSON, found {error}") from error
    if not isinstance(document, dict):
        raise StoreError(f"{path}: expected a JSON object, found {type(document).__name__}")
    return document


def write_file(path: Path, parts: Sequence[bytes]) -> None:
    """Write a file beside its place and move it there, so that it is whole or absent.

    It is on the disk when this returns: a power failure afterwards does not take it back.

    Raises
    ------
    StoreError
        The disk is full, or the folder cannot be written.
    """
    # Two machines may write the same file at once, when one was thought dead.
    partial = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with partial.open("wb") as file:
                file.writelines(parts)
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise
        _sync_folder(path.parent)
    except OSError as error:
        raise StoreError(f"{path}: expected room to write, found {error.strerror}") from error


def _sync_folder(folder: Path) -> None:
    """Make the names in a folder last; systems that cannot open folders do so by themselves."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def read_attributes(store: Path, *, complete: bool = True) -> dict[str, Any]:
    """Return the `nimprep` object of a store's root attributes.

    Parameters
    ----------
    complete : bool
        Refuse a store whose writing was cut short.

    Raises
    ------
    StoreError
        There is no store, it is of another program or version, or it is not complete.
    """
    if not store.exists():
        raise StoreError(f"{store}: expected a nimprep store, found nothing")
    if not (store / ROOT).is_file():
        raise StoreError(f"{store}: expected a nimprep store, found no {ROOT} in it")
    document = read_document(store / ROOT)
    attributes = document.get("attributes")
    found = attributes.get("nimprep") if isinstance(attributes, dict) else None
    if document.get("zarr_format") != 3 or not isinstance(found, dict):
        raise StoreError(
            f"{store}: expected a nimprep store, found a {ROOT} without 'nimprep' attributes"
        )
    check_version(found.get("format_version"), str(store))
    if complete and found.get("complete") is not True:
        raise StoreError(
            f"{store}: expected a complete store, found one whose conversion was cut short; "
            "run nimprep convert again"
        )
    return found


def write_attributes(store: Path, attributes: dict[str, Any]) -> None:
    """Replace the `nimprep` object of a store's root; all else there stays."""
    document = read_document(store / ROOT)
    document["attributes"] = {**document["attributes"], "nimprep": attributes}
    write_file(store / ROOT, [json.dumps(document, indent=2).encode() + b"\n"])
