"""What goes wrong in the program is never taken for a fault of a store, or of data."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import nimprep
from nimprep.store.validate import validate_store
from tests.fakes import write_gmrp

FAULTS = [
    RuntimeError("cannot cache function 'color_sums': no locator available"),
    MemoryError("cannot allocate 9 TiB"),
    ImportError("no module named numba"),
    AssertionError("a bug"),
    ZeroDivisionError("another"),
    TypeError("takes 2 positional arguments but 3 were given"),
]

PLACES = [
    "nimprep.store.validate.recipe_from",
    "nimprep.store.validate.table_specs",
    "nimprep.store.validate.layout_problems",
    "nimprep.store.validate.check_table",
    "nimprep.store.validate.consolidated",
    "nimprep.store.validate.MemoryFiles",
    "nimprep.store.validate.ImageArray.check_shard",
    "nimprep.store.validate.Store.camera",
    "nimprep.store.validate.read_attributes",
    "nimprep.store.validate.schema_problems",
    "nimprep.store.validate_deep.channel_sums",
    "nimprep.store.validate_deep.derive",
    "nimprep.store.validate_deep.recipe_from",
    "nimprep.store.images.decode_chunk",
    "nimprep.derive.normals.nim_rows",
    "nimprep.kernels.sums.color_sums",
    "zarr.open_array",
    "numpy.einsum",
]


TAKE_APART = {"nimprep.store.validate.recipe_from", "zarr.open_array"}
"""These are given nothing but a document, whose values may be of any type."""


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    with pytest.warns(UserWarning, match="nominal"):
        nimprep.convert(write_gmrp(folder / "gmrp", frames=2), folder / "s.zarr")
    assert validate_store(folder / "s.zarr", deep=True).valid
    return folder / "s.zarr"


@pytest.mark.parametrize(
    ("place", "fault"),
    [(p, f) for p in PLACES for f in FAULTS if not (p in TAKE_APART and isinstance(f, TypeError))],
    ids=lambda value: value if isinstance(value, str) else type(value).__name__,
)
def test_validation_hands_on_what_is_no_fault_of_the_store(
    place: str, fault: Exception, store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*arguments: Any, **named: Any) -> None:
        raise fault

    monkeypatch.setattr(place, fail)
    with pytest.raises(type(fault)) as raised:
        validate_store(store, deep=True)
    assert raised.value is fault


ROOT = Path(nimprep.__file__).parent

KNOWN = {("images/pillow.py", "pillow_header")}
"""Where any error of a library is one of the file that it was given."""


def too_broad(tree: ast.Module) -> Iterator[str]:
    """Yield the functions that swallow, or take for something else, whatever is raised."""
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        for node in ast.walk(function):
            if isinstance(node, ast.ExceptHandler):
                caught = ast.unparse(node.type) if node.type else "BaseException"
                last = node.body[-1]
                again = isinstance(last, ast.Raise) and last.exc is None
                if caught in ("Exception", "BaseException") and not again:
                    yield function.name
            elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("suppress"):
                named = {ast.unparse(argument) for argument in node.args}
                yield from [function.name] * bool(named & {"Exception", "BaseException"})


def test_nothing_in_the_package_takes_any_error_for_one_of_data() -> None:
    found = {
        (path.relative_to(ROOT).as_posix(), name)
        for path in sorted(ROOT.rglob("*.py"))
        for name in too_broad(ast.parse(path.read_text()))
    }
    assert found == KNOWN


@pytest.mark.parametrize("fault", [MemoryError("much"), ImportError("no PIL")])
def test_an_image_is_not_called_broken_for_the_programs_faults(
    fault: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from nimprep.images import pillow

    def fail(*arguments: Any) -> None:
        raise fault

    monkeypatch.setitem(pillow._FORMATS, b"BM", ("BMP", fail))
    with pytest.raises(type(fault)) as raised:
        pillow.pillow_header(b"BM" + bytes(60), tmp_path / "a.bmp")
    assert raised.value is fault
