"""What is wrong with a JSON document, in words for who wrote it."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

_MOST_NAMES = 12

_PATTERNS = {
    "^[^/]": "begins with '/', and patterns are below the dataset's folder",
    r"\{\w+\}": "has no {placeholder}",
}
"""What a text lacks that does not fit a schema's regular expression."""


def alike(name: str, names: Iterable[str]) -> str | None:
    """Return the name that was most likely meant; None = none is like it."""
    return next(iter(get_close_matches(name, list(names), 1, 0.7)), None)


def innermost(error: Any) -> Any:
    """Return the problem within a choice of schemas that tells most; `error` itself if it is none.

    The choice that a document comes closest to is the one of its kind, object or text, with the
    fewest problems; there, a key that is not known tells more than one that is missing.
    """
    while error.context:
        choices: dict[int, list[Any]] = {}
        for inner in error.context:
            choices.setdefault(inner.schema_path[0], []).append(inner)
        of_kind = [some for some in choices.values() if not any(map(_is_other_kind, some))]
        if not of_kind:
            return error
        closest = min(of_kind, key=lambda some: len(some))
        error = min(closest, key=lambda e: e.validator != "additionalProperties")
    return error


def _is_other_kind(error: Any) -> bool:
    return not error.path and error.validator in ("type", "const", "enum")


def worded(error: Any) -> str:
    """Return what a problem that jsonschema found is."""
    wanted, found = error.validator_value, error.instance
    message: str = error.message
    if error.validator == "additionalProperties" and wanted is False:
        return _unknown_key(found, error.schema.get("properties", {}))
    if error.validator == "const":
        return f"{found!r}, and not {wanted!r}"
    if error.validator == "enum" and isinstance(found, str):
        meant = alike(found, [each for each in wanted if isinstance(each, str)])
        return message + _question(meant)
    if error.validator == "type" and isinstance(found, str):
        return message + _step_of_text(found, wanted)
    if error.validator in ("maxItems", "minItems") and isinstance(found, list):
        most = "at most" if error.validator == "maxItems" else "at least"
        return f"{found!r} with {len(found)} items, and not {most} {wanted}"
    if error.validator == "pattern" and wanted in _PATTERNS:
        return f"{found!r} {_PATTERNS[wanted]}"
    return message


def _unknown_key(found: dict[str, Any], known: dict[str, Any]) -> str:
    unknown = next((key for key in found if key not in known), "")
    if meant := alike(unknown, [key for key in known if key not in found]):
        return f"the unknown key {unknown!r}" + _question(meant)
    names = ", ".join(list(known)[:_MOST_NAMES]) + (", ..." if len(known) > _MOST_NAMES else "")
    return f"the unknown key {unknown!r}; known are {names}"


def _question(meant: str | None) -> str:
    return "" if meant is None else f"; did you mean {meant!r}?"


def _step_of_text(found: str, wanted: Any) -> str:
    if wanted in ("number", "integer"):
        try:
            float(found)
        except ValueError:
            return ""
        return "; leave out the quotes"
    return '; write {"files": ..., ...}' if wanted == "object" else ""
