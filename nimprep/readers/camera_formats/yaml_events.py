"""YAML of somebody else's, read without running anything and without aliases.

OpenCV's FileStorage (``%YAML:1.0``, ``!!opencv-matrix``) is read too. Scalars are texts: YAML's own
idea of a number has 12:30 as 750 and 1e-3 as no number.
"""

from __future__ import annotations

import re
from typing import Any

from nimprep.errors import CameraError

MAX_BYTES = 1 << 18
"""YAML of more bytes is refused: PyYAML reads some 100 kB a second."""

_DEEPEST = 32
_HEADER = re.compile(r"\A\ufeff?%YAML[: ]?1\.\d[^\n]*\n")


def parse_yaml(text: str, where: str) -> Any:
    """Return the first document of a YAML text: mappings, lists and texts.

    Raises
    ------
    CameraError
        It is no YAML, too large or too deep, or has aliases or a key twice.
    """
    from yaml import BaseLoader, YAMLError, parse

    if len(text) > MAX_BYTES:
        raise CameraError(
            f"{where}: expected a camera in YAML of at most {MAX_BYTES} bytes, found more; "
            "keep the camera's part of it"
        )
    try:
        return _document(parse(_HEADER.sub("", text), Loader=BaseLoader), where)
    except YAMLError as error:
        found = " ".join(str(error).split())[:200]
        raise CameraError(
            f"{where}: expected a camera in YAML, found {found}; give the camera in JSON"
        ) from error


def _document(events: Any, where: str) -> Any:
    """Return what the events of the first document make, with a stack of its own."""
    from yaml.events import (
        AliasEvent,
        CollectionEndEvent,
        DocumentEndEvent,
        MappingStartEvent,
        ScalarEvent,
        SequenceStartEvent,
    )

    top: list[Any] = []
    # Each a container, and the key whose value comes next.
    stack: list[tuple[Any, list[str]]] = [(top, [])]
    for event in events:
        if isinstance(event, AliasEvent):
            raise _refused(where, "no aliases", f"*{event.anchor}")
        if isinstance(event, CollectionEndEvent):
            stack.pop()
        elif isinstance(event, ScalarEvent):
            _add(stack[-1], event.value, where)
        elif isinstance(event, (MappingStartEvent, SequenceStartEvent)):
            made: Any = {} if isinstance(event, MappingStartEvent) else []
            _add(stack[-1], made, where)
            stack.append((made, []))
        if len(stack) > _DEEPEST:
            raise _refused(where, f"at most {_DEEPEST} levels", "more")
        if isinstance(event, DocumentEndEvent):
            break
    return top[0] if top else None


def _add(place: tuple[Any, list[str]], value: Any, where: str) -> None:
    container, key = place
    if isinstance(container, list):
        container.append(value)
    elif key:
        container[key.pop()] = value
    elif not isinstance(value, str):
        raise _refused(where, "texts as keys", "a list or a mapping")
    elif value in container:
        raise _refused(where, "each key once", repr(value[:80]))
    else:
        key.append(value)


def _refused(where: str, expected: str, found: str) -> CameraError:
    return CameraError(
        f"{where}: expected {expected} in a camera's YAML, found {found}; give the camera in JSON"
    )
