"""What was compiled is found again, and whatever is in its place instead is compiled over."""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import nimprep
from nimprep.compilation import cache
from nimprep.compilation.decorator import KERNELS
from nimprep.compilation.folders import SAID, CacheFolders, Place

SOURCE = """
from numba import float64

from nimprep.compilation.decorator import kernel

FACTOR = 2.0


@kernel()
def _helped(x):
    return x + 1


@kernel(float64(float64))
def doubled(x):
    return _helped(x) * FACTOR
"""

Run = Callable[[], tuple[float, cache.KernelCache]]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only folder that kernels are kept in meanwhile."""
    place = tmp_path / "kept"
    monkeypatch.delenv(SAID, raising=False)
    monkeypatch.setattr(cache, "FOLDERS", CacheFolders(lambda: [Place(place)]))
    return place


@pytest.fixture
def run(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Import a module with a kernel as a new process would; call it."""
    (tmp_path / "some_kernels.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)

    def imported() -> tuple[float, cache.KernelCache]:
        sys.modules.pop("some_kernels", None)
        cache.code_digest.cache_clear()
        cache._source.cache_clear()
        importlib.invalidate_caches()
        module = importlib.import_module("some_kernels")
        return module.doubled(3.0), KERNELS.pop("some_kernels.doubled")

    return imported


def only(folder: Path) -> Path:
    (file,) = folder.iterdir()
    return file


def test_a_kernel_is_compiled_once_and_then_loaded(run: Run, folder: Path) -> None:
    value, first = run()
    assert (value, first.compiled, first.loaded) == (8.0, 1, 0)
    kept = only(folder).read_bytes()
    value, second = run()
    assert (value, second.compiled, second.loaded) == (8.0, 0, 1)
    assert only(folder).read_bytes() == kept
    assert second.cache_path == str(folder)


def cut(length: int) -> Callable[[Path], None]:
    return lambda file: file.write_bytes(file.read_bytes()[:length])


def flipped(place: float) -> Callable[[Path], None]:
    def flip(file: Path) -> None:
        content = bytearray(file.read_bytes())
        content[int(place * (len(content) - 1))] ^= 1
        file.write_bytes(content)

    return flip


def emptied(file: Path) -> None:
    file.unlink()
    file.mkdir()


def linked_to_itself(file: Path) -> None:
    file.unlink()
    file.symlink_to(file)


DAMAGE: dict[str, Callable[[Path], Any]] = {
    "gone": lambda file: file.unlink(),
    "empty": cut(0),
    "in the first digest": cut(7),
    "at the first digest's end": cut(32),
    "in the second digest": cut(40),
    "at the pickle's start": cut(64),
    "in the pickle": cut(1000),
    "by one byte": cut(-1),
    "garbage": lambda file: file.write_bytes(b"garbage" * 999),
    "longer": lambda file: file.write_bytes(file.read_bytes() + b"\0"),
    "a folder": emptied,
    "a link that loops": linked_to_itself,
    **{f"a bit at {place}": flipped(place) for place in (0, 0.01, 0.3, 0.5, 0.7, 1)},
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE.keys())
def test_what_is_damaged_is_compiled_again_and_mended(
    damage: Callable[[Path], None], run: Run, folder: Path
) -> None:
    run()
    damage(only(folder))
    value, second = run()
    assert (value, second.compiled) == (8.0, 1)
    assert run()[1].loaded == 1
    assert only(folder).is_file()


def test_what_cannot_be_replaced_is_said_once_and_costs_a_compilation(
    run: Run, folder: Path
) -> None:
    run()
    file = only(folder)
    emptied(file)
    (file / "something").touch()
    with pytest.warns(UserWarning, match=r"doubled.*NUMBA_CACHE_DIR"):
        assert run()[0] == 8.0
    value, third = run()
    assert (value, third.compiled) == (8.0, 1)
    assert only(folder) == file


def test_a_changed_constant_or_option_is_compiled_anew_over_the_old(
    run: Run, folder: Path, tmp_path: Path
) -> None:
    run()
    file = only(folder)
    changes = [("FACTOR = 2.0", "FACTOR = 3.0", 12.0), ("@kernel()", "@kernel(inline=True)", 8.0)]
    for old, new, expected in changes:
        (tmp_path / "some_kernels.py").write_text(SOURCE.replace(old, new))
        value, second = run()
        assert (value, second.compiled) == (expected, 1)
        assert only(folder) == file


def test_what_another_version_of_numba_compiled_is_not_read(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run()
    monkeypatch.setattr("numba.__version__", "0.1")
    assert run()[1].compiled == 1
    assert only(folder).is_file()


ROOT = Path(nimprep.__file__).parent

MODULES = {
    ".".join(("nimprep", *path.relative_to(ROOT).with_suffix("").parts)): path
    for path in sorted(ROOT.rglob("kernels/*.py"))
    if path.name != "__init__.py"
}


def needed(name: str) -> set[str]:
    """Return a module with kernels and all such that it imports from, by their trees."""
    found = {name}
    for node in ast.walk(ast.parse(MODULES[name].read_text())):
        if isinstance(node, ast.ImportFrom) and node.module in MODULES:
            found |= needed(node.module)
    return found


def test_a_kernel_depends_on_the_modules_it_is_made_from_and_on_no_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert any(len(needed(name)) > 1 for name in MODULES)
    for name in MODULES:
        importlib.import_module(name)
    read, digest = cache._source, cache.code_digest.__wrapped__
    before = {name: digest(name) for name in MODULES}
    for other in MODULES:
        monkeypatch.setattr(cache, "_source", lambda m, other=other: read(m) + b"#" * (m == other))
        changed = {name for name in MODULES if digest(name) != before[name]}
        assert changed == {name for name in MODULES if other in needed(name)}
