"""What goes wrong in the program is never taken for a fault of a store, or of data."""

from __future__ import annotations

import ast
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import nimprep
from nimprep.errors import StoreError
from nimprep.store.checksums import with_digest
from nimprep.store.connection import RequestError
from nimprep.store.validate import _MALFORMED, validate_store
from tests.fakes import write_gmrp

FAULTS = [
    RuntimeError("cannot cache function 'color_sums': no locator available"),
    MemoryError("cannot allocate 9 TiB"),
    ImportError("no module named numba"),
    AssertionError("a bug"),
    ZeroDivisionError("another"),
    TypeError("takes 2 positional arguments but 3 were given"),
    ValueError("not enough values to unpack"),
    KeyError("hha"),
    IndexError("list index out of range"),
    AttributeError("no attribute 'frames'"),
]

OUT_OF_REACH = RequestError("s3://bucket/a.zarr: expected an answer, found none")
OUT_OF_REACH.__cause__ = TimeoutError()
FAULTS.append(OUT_OF_REACH)

PLACES = [
    "nimprep.store.validate.recipe_from",
    "nimprep.store.validate.table_specs",
    "nimprep.store.validate.layout_problems",
    "nimprep.store.validate.check_table",
    "nimprep.store.frame_tables.decode_table",
    "nimprep.store.tables.check_table",
    "nimprep.store.reader.stored_modalities",
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


TAKE_APART = {"zarr.open_array"}
"""This is given nothing but a document, whose values may be of any type."""


NO_REQUESTS = {"nimprep.store.validate.Store.camera"}
"""All that this needs was read before."""


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    with pytest.warns(UserWarning, match="nominal"):
        nimprep.convert(write_gmrp(folder / "gmrp", frames=2), folder / "s.zarr")
    assert validate_store(folder / "s.zarr", deep=True).valid
    return folder / "s.zarr"


@pytest.mark.parametrize(
    ("place", "fault"),
    [
        (p, f)
        for p in PLACES
        for f in FAULTS
        if not (p in TAKE_APART and isinstance(f, _MALFORMED))
        and not (p in NO_REQUESTS and f is OUT_OF_REACH)
    ],
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


@pytest.mark.parametrize("version", ["1.2", "1.999"])
@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("normal", {"method": "nim-2"}, "normals: expected one of nim, nim-edge, found 'nim-2'"),
        ("normal", {"parameters": {"fill": ["none"]}}, "fill: expected one of"),
        ("normal", {"parameters": {"noise": "much"}}, "noise: expected a finite number"),
        ("normal", {"parameters": {"noise": None}}, "noise: expected a finite number"),
        ("normal", {"parameters": {"noise": 10**400}}, "noise: expected a finite number"),
    ],
)
def test_a_recipe_that_nobody_knows_is_the_stores_fault_and_one_of_a_later_version_is_not(
    version: str, name: str, change: dict[str, Any], words: str, store: Path, tmp_path: Path
) -> None:
    ours = shutil.copytree(store, tmp_path / "s.zarr")
    document = json.loads((ours / "zarr.json").read_text())
    attributes = document["attributes"]["nimprep"]
    attributes["modalities"][name].update(change)
    attributes["format_version"] = version
    document["attributes"]["nimprep"] = with_digest(attributes)
    (ours / "zarr.json").write_text(json.dumps(document))
    if version == "1.2":
        (problem,) = [p for p in validate_store(ours).problems if "frames" not in p]
        assert problem.startswith(f"attributes: modalities: {words}")
        return
    with pytest.raises(StoreError, match=f"{words}.*; validate it with the version that wrote it"):
        validate_store(ours)


@pytest.mark.parametrize("name", ["split", "frame_id", "intrinsics"])
@pytest.mark.parametrize("shape", [[], {}, "", None, [[]], [2.0], [True]])
def test_a_table_of_whatever_shape_is_the_stores_fault(
    name: str, shape: object, store: Path, tmp_path: Path
) -> None:
    ours = shutil.copytree(store, tmp_path / "s.zarr")
    document = json.loads((ours / name / "zarr.json").read_text())
    document["shape"] = document["chunk_grid"]["configuration"]["chunk_shape"] = shape
    (ours / name / "zarr.json").write_text(json.dumps(document))
    (problem,) = validate_store(ours).problems
    assert f"{name}: expected a table in one chunk, found" in problem


ROOT = Path(nimprep.__file__).parent

KNOWN = {
    ("images/pillow.py", "pillow_header"),
    ("images/archive.py", "_opened"),
    ("images/exr.py", "decode_exr"),
    ("images/hdf5.py", "_opened"),
    ("images/palette.py", "read_palette_index"),
}
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
