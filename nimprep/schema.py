"""The JSON Schemas the project ships, and checking JSON against them."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

from nimprep.errors import DecodeError, NimprepError

_PACKAGED = Path(__file__).parent / "schemas"
_SOURCE_TREE = Path(__file__).parent.parent / "schemas"


@cache
def load_schema(name: str) -> dict[str, Any]:
    """Return the schema ``schemas/<name>.schema.json``, from the wheel or the source tree."""
    folder = _PACKAGED if _PACKAGED.is_dir() else _SOURCE_TREE
    schema: dict[str, Any] = json.loads((folder / f"{name}.schema.json").read_text("utf-8"))
    return schema


@cache
def _validator(name: str) -> Any:
    from jsonschema import Draft202012Validator

    return Draft202012Validator(load_schema(name))


def schema_problems(document: Any, name: str) -> list[str]:
    """Return what is wrong with a document by a schema, a line each; empty = nothing."""
    problems = []
    for error in sorted(_validator(name).iter_errors(document), key=lambda e: e.json_path):
        # jsonschema quotes the whole instance; a line must stay readable.
        message = error.message if len(error.message) <= 200 else error.message[:197] + "..."
        problems.append(f"{error.json_path}: {message}")
    return problems


def check_json(
    document: Any, name: str, where: str, error: type[NimprepError] = DecodeError
) -> None:
    """Raise `error` with the first problem where a document does not fit a schema."""
    problems = schema_problems(document, name)
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise error(f"{where}: expected JSON of schema {name!r}, found {problems[0]}{more}")


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name}, which is no JSON number")


def read_json(path: Path, error: type[NimprepError] = DecodeError) -> Any:
    """Read a JSON file of a user's.

    Raises
    ------
    NimprepError
        Of the class given: the file is missing, unreadable, or not JSON.
    """
    try:
        return json.loads(path.read_text("utf-8-sig"), parse_constant=_refuse_constant)
    except OSError as caught:
        raise error(f"{path}: expected a readable JSON file, found {caught.strerror}") from caught
    except (ValueError, RecursionError) as caught:
        raise error(f"{path}: expected JSON, found {caught}") from caught
