"""The JSON Schemas the project ships, and checking JSON against them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

from nimprep.errors import DecodeError, NimprepError
from nimprep.files import read_file
from nimprep.schema_wording import innermost, worded

_PACKAGED = Path(__file__).parent / "schemas"
_SOURCE_TREE = Path(__file__).parent.parent / "schemas"

MAX_BYTES = 1 << 25
"""A JSON document of more bytes is refused: half a million frames' metadata take less."""

MAX_PROBLEMS = 100
"""A document's problems are counted up to here: a list of wrong items could have millions."""

_MAX_CONTAINERS = 1 << 20
_DEEPEST = 64
_QUOTED = 200


def json_bytes(document: Any) -> bytes:
    """Return a JSON file's bytes, laid out for people to read too."""
    return json.dumps(document, indent=2).encode() + b"\n"


@cache
def load_schema(name: str) -> dict[str, Any]:
    """Return the schema ``schemas/<name>.schema.json``, from the wheel or the source tree."""
    folder = _PACKAGED if _PACKAGED.is_dir() else _SOURCE_TREE
    schema: dict[str, Any] = json.loads((folder / f"{name}.schema.json").read_text("utf-8"))
    return schema


@cache
def _validator(name: str, part: str | None = None) -> Any:
    from jsonschema import Draft202012Validator
    from jsonschema.validators import extend

    schema = load_schema(name)
    if part is not None:
        schema = {**schema["properties"][part], "$defs": schema.get("$defs", {})}
    return extend(Draft202012Validator, {"items": _items})(schema)


def _items(validator: Any, items: Any, instance: Any, schema: Any) -> Iterator[Any]:
    """Check an array's items as jsonschema does, some hundred times as fast for plain ones.

    A store can name each of its frames several times, at 10 microseconds for each.
    """
    if not isinstance(instance, list):
        return
    kind = {"string": str, "integer": int}.get(items.get("type", ""))
    shortest, least = items.get("minLength", 0), items.get("minimum", -math.inf)
    plain = set(items) <= {"type", "minLength", "minimum"} and kind is not None
    for place, item in enumerate(instance):
        fits = plain and type(item) is kind
        if fits and (len(item) >= shortest if kind is str else item >= least):
            continue
        yield from validator.descend(item, items, path=place)


def schema_problems(document: Any, name: str, part: str | None = None) -> list[str]:
    """Return what is wrong with a document by a schema, a line each; empty = nothing.

    At most `MAX_PROBLEMS` lines. With `part`, the document is the property of that name alone.
    """
    found = map(innermost, islice(_validator(name, part).iter_errors(document), MAX_PROBLEMS))
    # jsonschema quotes the whole instance; a line must stay readable.
    return [
        f"{_shortened(error.json_path)}: {_shortened(worded(error))}"
        for error in sorted(found, key=_place)
    ]


def _place(error: Any) -> tuple[str, bool]:
    """Order problems by where they are; a wrong key tells more than one that is missing."""
    return error.json_path, error.validator != "additionalProperties"


def _shortened(text: str) -> str:
    return text if len(text) <= _QUOTED else text[: _QUOTED - 3] + "..."


def check_json(
    document: Any, name: str, where: str, error: type[NimprepError] = DecodeError
) -> None:
    """Raise `error` with the first problem where a document does not fit a schema."""
    problems = schema_problems(document, name)
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise error(f"{where}: expected JSON of schema {name!r}, found {problems[0]}{more}")


def parse_json(data: bytes) -> Any:
    """Return what a JSON document of somebody else's holds.

    Raises
    ------
    ValueError
        It is no JSON, or JSON that would be trouble later: numbers that are not finite, lists in
        lists beyond any sense, or more of them than memory should be spent on.
    """
    containers = data.count(b"[") + data.count(b"{")
    if containers > _MAX_CONTAINERS:
        raise ValueError(f"{containers} lists and objects, which are too many")
    try:
        document = json.loads(
            data.decode("utf-8-sig"), parse_constant=_refuse_constant, parse_float=_finite
        )
    except RecursionError:
        raise ValueError("lists or objects nested too deeply") from None
    if _depth(document) > _DEEPEST:
        # Whoever walks through it recursively, to check, print or write it, must not run aground.
        raise ValueError(f"lists or objects nested more than {_DEEPEST} deep")
    return document


def _depth(document: Any) -> int:
    depth, level = 0, [document]
    while level:
        level = [
            item
            for container in level
            if isinstance(container, (dict, list))
            for item in (container.values() if isinstance(container, dict) else container)
            if isinstance(item, (dict, list))
        ]
        depth += 1
    return depth


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name}, which is no JSON number")


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"the number {_shortened(text)}, which is too large")
    return number


def read_json(path: Path, error: type[NimprepError] = DecodeError, *, pipes: bool = True) -> Any:
    """Read a JSON file of a user's.

    Parameters
    ----------
    pipes : bool
        Take a pipe too: the user may name one, a dataset may not.

    Raises
    ------
    NimprepError
        Of the class given: the file is missing, unreadable, too large, or not JSON.
    """
    data = read_file(path, MAX_BYTES, "a readable JSON file", error, pipes=pipes)
    try:
        return parse_json(data)
    except ValueError as caught:
        raise error(f"{path}: expected JSON, found {caught}") from caught
