"""A store's JSON documents: written whole or not at all; doubts in reading are `StoreError`s."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from nimprep.errors import StoreError
from nimprep.schema import MAX_BYTES, json_bytes, parse_json
from nimprep.store.access import storage_from
from nimprep.store.checksums import with_digest
from nimprep.store.spec import check_version

if TYPE_CHECKING:
    from nimprep.store.storage import Storage

ROOT = "zarr.json"


def read_document(storage: Storage, key: str) -> dict[str, Any]:
    """Read a zarr.json.

    Raises
    ------
    StoreError
        It is missing, unreadable or no JSON object.
    """
    data = storage.read(key, MAX_BYTES)
    if data is None:
        raise StoreError(f"{storage}/{key}: expected a readable file, found none")
    return _parsed(data, f"{storage}/{key}")


def _parsed(data: bytes, where: str) -> dict[str, Any]:
    try:
        document = parse_json(data)
    except ValueError as error:
        raise StoreError(f"{where}: expected JSON, found {error}") from error
    if not isinstance(document, dict):
        raise StoreError(f"{where}: expected a JSON object, found {type(document).__name__}")
    return document


def consolidated(root: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the arrays' documents by name, as far as a store's root has copies of them."""
    copies = root.get("consolidated_metadata")
    found = copies.get("metadata") if isinstance(copies, dict) else None
    if not isinstance(found, dict):
        return {}
    return {name: copy for name, copy in found.items() if isinstance(copy, dict)}


def read_attributes(store: Path | str | Storage, *, complete: bool = True) -> dict[str, Any]:
    """Return the `nimprep` object of a store's root attributes; see `read_root`."""
    attributes: dict[str, Any] = read_root(storage_from(store), complete=complete)["attributes"]
    found: dict[str, Any] = attributes["nimprep"]
    return found


def read_root(storage: Storage, *, complete: bool = True) -> dict[str, Any]:
    """Return the document of a store's root, with a `nimprep` object among its attributes.

    Parameters
    ----------
    complete : bool
        Refuse a store whose writing was cut short.

    Raises
    ------
    StoreError
        There is no store, it is of another program or version, or it is not complete.
    """
    return root_from(storage.read(ROOT, MAX_BYTES), storage, complete=complete)


def root_from(data: bytes | None, storage: Storage, *, complete: bool = True) -> dict[str, Any]:
    """Return the document of a store's root from its bytes, None = none; see `read_root`."""
    if data is None:
        there = Path(str(storage)).exists()
        said = f"no {ROOT} in it" if there else "nothing"
        raise StoreError(f"{storage}: expected a nimprep store, found {said}")
    document = _parsed(data, f"{storage}/{ROOT}")
    attributes = document.get("attributes")
    found = attributes.get("nimprep") if isinstance(attributes, dict) else None
    if document.get("zarr_format") != 3 or not isinstance(found, dict):
        raise StoreError(
            f"{storage}: expected a nimprep store, found a {ROOT} without 'nimprep' attributes"
        )
    check_version(found.get("format_version"), str(storage))
    if complete and found.get("complete") is not True:
        raise StoreError(
            f"{storage}: expected a complete store, found one whose conversion was cut short; "
            "run nimprep convert again"
        )
    return document


def write_attributes(store: Path | str | Storage, attributes: dict[str, Any]) -> None:
    """Replace the `nimprep` object of a store's root, with a new digest; all else there stays."""
    storage = storage_from(store)
    document = read_document(storage, ROOT)
    document["attributes"] = {**document["attributes"], "nimprep": with_digest(attributes)}
    storage.write(ROOT, [json_bytes(document)])
