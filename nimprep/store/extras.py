"""What lies in a store that is not of nimprep's making: somebody's notes, arrays or attributes.

Nothing of it is destroyed: whoever replaces a store refuses and names it, and a store that grows
keeps it.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Collection, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from nimprep.errors import StoreError
from nimprep.folders import PARTIAL, link_tree
from nimprep.schema import json_bytes
from nimprep.store.metadata import ROOT, consolidated, read_document
from nimprep.store.spec import image_spec, stored_modalities
from nimprep.store.storage import LocalStorage, Storage
from nimprep.store.table_specs import table_specs

PACKED = "packed"
"""Where shards wait for a moment while a conversion closes the gaps of frames left out."""

_ROOT_FIELDS = {"zarr_format", "node_type", "attributes", "consolidated_metadata"}

_NAMED = 3
"""A message names so many; of the others it gives the number."""


def own_arrays(attributes: Any) -> set[str]:
    """Return the names of the arrays that nimprep wrote into a store of these attributes."""
    modalities = attributes.get("modalities") if isinstance(attributes, dict) else None
    return {*(modalities if isinstance(modalities, dict) else ()), *table_specs()}


def is_own(key: str, arrays: Collection[str]) -> bool:
    """Return whether a key is one of those that nimprep writes, or left when it was killed."""
    first, *rest = key.removeprefix(f"{PACKED}/").split("/")
    name = (rest or [first])[-1]
    if name.startswith(".") and name.endswith(PARTIAL):
        return True
    if not rest:
        return key in (ROOT, f"{PACKED}/done")
    return first in arrays and (rest == [ROOT] or (len(rest) > 1 and _is_chunk(rest)))


def _is_chunk(parts: list[str]) -> bool:
    return parts[:1] == ["c"] and all(part.isdecimal() for part in parts[1:])


def extra_keys(keys: Iterable[str], arrays: Collection[str]) -> list[str]:
    """Return those of a store's keys that are not nimprep's."""
    return [key for key in keys if not is_own(key, arrays)]


def extra_paths(folder: Path, arrays: Collection[str]) -> list[str]:
    """Return the files, links and folders within a store that are not nimprep's.

    Of a folder that is not, its own name alone; links are not followed.
    """
    found = []
    for path, folders, names in os.walk(folder):
        prefix = Path(path).relative_to(folder)
        keys = [(prefix / name).as_posix() for name in names]
        found += extra_keys(keys, arrays)
        for name in list(folders):
            first, *rest = (prefix / name).parts
            if not (first in arrays and (not rest or _is_chunk(rest))):
                found.append((prefix / name).as_posix())
                folders.remove(name)
    return sorted(found)


def extra_attributes(storage: Storage) -> list[str]:
    """Return what stands in a store's documents that nimprep did not write, for a message.

    A document that is damaged has nothing that could be kept.
    """
    root = read_document(storage, ROOT)
    found = [f"{name!r} in {ROOT}" for name in root.keys() - _ROOT_FIELDS]
    found += [f"attribute {name!r}" for name in root["attributes"].keys() - {"nimprep"}]
    for name, known in _known_attributes(root["attributes"]["nimprep"]).items():
        with suppress(StoreError):
            there = _attributes_of(storage, name)
            found += [f"attribute {key!r} of {name!r}" for key in there.keys() - known]
    return sorted(found)


def _known_attributes(attributes: dict[str, Any]) -> dict[str, set[str]]:
    described = attributes.get("modalities")
    modalities = {}
    if isinstance(described, dict):
        whole = {name: d for name, d in described.items() if isinstance(d, dict)}
        with suppress(KeyError, TypeError, ValueError, StoreError):
            modalities = stored_modalities(whole)
    specs = {name: image_spec(modality, ()) for name, modality in modalities.items()}
    return {name: set(spec.attributes) for name, spec in {**specs, **table_specs()}.items()}


def check_replaceable(storage: Storage) -> None:
    """Make sure that replacing a store destroys nothing but what nimprep wrote.

    Raises
    ------
    StoreError
        It would.
    """
    arrays = own_arrays(read_document(storage, ROOT)["attributes"]["nimprep"])
    root = storage.root
    keys = extra_paths(root, arrays) if root else extra_keys(storage.keys(), arrays)
    found = [*map(repr, keys), *extra_attributes(storage)]
    if found:
        more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
        raise StoreError(
            f"{storage}: expected a store with nothing in it but what nimprep wrote, found "
            f"{', '.join(found[:_NAMED])}{more}, which would be lost; move that elsewhere, or "
            "choose another name"
        )


def check_growable(folder: Path) -> None:
    """Raise `StoreError` where a store has somebody's array that would lack the new frames.

    Such an array would make xarray refuse the store as a whole.
    """
    attributes = read_document(LocalStorage(folder), ROOT)["attributes"]["nimprep"]
    for name in extra_paths(folder, own_arrays(attributes)):
        with suppress(StoreError):
            document = read_document(LocalStorage(folder), f"{name}/{ROOT}")
            dims = document.get("dimension_names")
            if isinstance(dims, list) and "frame" in dims:
                break
    else:
        return
    raise StoreError(
        f"{folder}: expected no arrays along 'frame' but nimprep's, found {name!r}, which would "
        "lack the new frames; move it elsewhere, and put it back when it has them"
    )


def carry_over(old: Path, new: Path) -> None:
    """Give a store that is to replace another what that has beside nimprep's own: files by links.

    Raises
    ------
    StoreError
        It cannot be written.
    """
    storage, made = LocalStorage(old), LocalStorage(new)
    root, found = read_document(storage, ROOT), read_document(made, ROOT)
    before = json.dumps(found)
    arrays = own_arrays(root["attributes"]["nimprep"])
    paths = extra_paths(old, arrays)
    for path in paths:
        link_tree(old / path, new / path, StoreError)
    found.update({name: value for name, value in root.items() if name not in _ROOT_FIELDS})
    _add(found["attributes"], root["attributes"])
    copies = consolidated(found)
    # A store of an older format lacks tables that the new one has.
    for name in arrays & copies.keys():
        if not (old / name / ROOT).exists():
            continue
        if _add(copies[name]["attributes"], _attributes_of(storage, name)):
            made.write(f"{name}/{ROOT}", [json_bytes(copies[name])])
    copies.update({n: c for n, c in consolidated(root).items() if n.split("/")[0] in paths})
    found["consolidated_metadata"]["metadata"] = copies
    if json.dumps(found) != before:
        made.write(ROOT, [json_bytes(found)])


def _attributes_of(storage: Storage, name: str) -> dict[str, Any]:
    attributes = read_document(storage, f"{name}/{ROOT}").get("attributes")
    return attributes if isinstance(attributes, dict) else {}


def _add(attributes: dict[str, Any], more: dict[str, Any]) -> bool:
    """Add the attributes that are not there; return whether any were."""
    missing = {name: value for name, value in more.items() if name not in attributes}
    attributes.update(missing)
    return bool(missing)


def discard(old: Path, target: Path) -> None:
    """Remove a store that was replaced; what came into it meanwhile goes on in the other's place.

    Never fails: what cannot be removed stays where it is.
    """
    with suppress(StoreError, OSError, KeyError, TypeError):
        attributes = read_document(LocalStorage(old), ROOT)["attributes"]["nimprep"]
        for path in extra_paths(old, own_arrays(attributes)):
            _rescue(old / path, target / path)
    with suppress(OSError):
        # First of all, so that what a kill leaves of it is never taken for a store.
        (old / ROOT).unlink(missing_ok=True)
    shutil.rmtree(old, ignore_errors=True)


def _rescue(path: Path, place: Path) -> None:
    """Move what is not there, or was there in an older state."""
    if path.is_dir() and place.is_dir() and not (path.is_symlink() or place.is_symlink()):
        for inner in path.iterdir():
            _rescue(inner, place / inner.name)
    elif not os.path.lexists(place) or (
        path.lstat().st_mtime_ns > place.lstat().st_mtime_ns and not path.is_dir()
    ):
        place.parent.mkdir(parents=True, exist_ok=True)
        path.replace(place)
