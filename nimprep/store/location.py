"""Where a store is: a folder, or a URL."""

from __future__ import annotations

import os
import re
from pathlib import Path
from urllib.parse import unquote, urlsplit

from nimprep.errors import StoreError

Place = Path | str
"""A folder, or the URL of what is none."""

SCHEMES = ("s3", "s3a", "gs", "az", "azure", "abfs", "abfss", "adl", "http", "https")
"""What the extra `cloud` reaches; http and https for reading."""

_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")
_BENT = re.compile(rf"(?:{'|'.join(SCHEMES)}):/")


def is_url(place: object) -> bool:
    """Return whether a place is given as a URL, file:// included."""
    return isinstance(place, str) and _URL.match(place) is not None


def location_from(place: Path | str | os.PathLike[str]) -> Place:
    """Return a place as a folder's path, or as a URL without a slash at its end.

    Raises
    ------
    StoreError
        It is a URL of a kind that cannot be read.
    """
    if not isinstance(place, str) or not (match := _URL.match(place)):
        path = Path(place)
        if _BENT.match(str(path)) and not path.exists():
            raise StoreError(
                f"{path}: expected a folder or a URL, found a URL that went through a path and "
                "lost a slash; give it as text"
            )
        return path
    scheme, rest = match[1].lower(), place[match.end() :]
    if scheme == "file":
        return Path(unquote(urlsplit(place).path))
    if scheme not in SCHEMES:
        raise StoreError(
            f"{place}: expected a folder or a URL that starts with one of "
            f"{', '.join(f'{s}://' for s in SCHEMES)}, found {scheme}://"
        )
    if "?" in rest or "#" in rest:
        raise StoreError(f"{place}: expected a URL without ? and #, found one with them")
    if not rest.strip("/"):
        raise StoreError(f"{place}: expected a bucket in the URL, found none")
    return f"{scheme}://{rest.rstrip('/')}"
