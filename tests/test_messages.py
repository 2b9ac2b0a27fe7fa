"""Whatever ends a command says what to do next."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import nimprep

ROOT = Path(nimprep.__file__).parent

FILES = [*sorted((ROOT / "conversion").glob("*.py")), ROOT / "files.py", ROOT / "folders.py"]

KNOWN = {
    # Those who catch these say more.
    ("records.py", "unseal"),
    ("records.py", "from_json"),
    ("encode.py", "_padded"),
    # A frame that lacks an image, and what the system says of a file: that is all there is.
    ("encode.py", "_chunks"),
    ("files.py", "open_plain"),
    ("files.py", "read_file"),
    ("folders.py", "told"),
}


def said(node: ast.expr) -> str:
    """Return a message as far as it stands in the code."""
    return "".join(
        part.value
        for part in ast.walk(node)
        if isinstance(part, ast.Constant) and isinstance(part.value, str)
    )


def without_a_step(tree: ast.Module) -> Iterator[str]:
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef):
            for node in ast.walk(function):
                if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and node.exc.args:
                    message = said(node.exc.args[0])
                    if "expected" in message and "; " not in message:
                        yield function.name


def test_an_error_of_a_conversion_or_of_writing_names_a_next_step() -> None:
    found = {
        (path.name, name) for path in FILES for name in without_a_step(ast.parse(path.read_text()))
    }
    assert found == KNOWN
