"""What reads and writes the bytes of a place: folders and URLs both offer them as a `Storage`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, cast

from nimprep.store.location import location_from
from nimprep.store.storage import LocalStorage, Storage

if TYPE_CHECKING:
    from nimprep.store.objects import ObjectStorage


def storage_from(place: Path | str | os.PathLike[str] | Storage) -> LocalStorage | ObjectStorage:
    """Return what reads and writes a place; what is a storage stays as it is.

    Raises
    ------
    StoreError
        It is a URL that cannot be read, or the extra `cloud` is missing.
    """
    if not isinstance(place, (str, os.PathLike)):
        return cast("LocalStorage | ObjectStorage", place)  # there are these two
    place = location_from(place)
    if isinstance(place, Path):
        return LocalStorage(place)
    from nimprep.store.objects import ObjectStorage

    return ObjectStorage(place)
