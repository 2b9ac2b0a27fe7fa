"""Datasets of the reference data's neighbours: reported cases, and public layouts."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from nimprep.cli import main

PROJECT = Path(__file__).resolve().parent.parent.parent


def folder(name: str) -> Path:
    """Return a folder beside the reference data; CI requires it, elsewhere it may be absent."""
    data = Path(os.environ.get("NIMPREP_REFERENCE_DATA", PROJECT.parent / "shared" / "data"))
    found = data.parent / name
    if not (found / "README.md").is_file():
        reason = f"no {name} at {found}; set NIMPREP_REFERENCE_DATA to the folder data beside them"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    return found


def make_case(name: str, out: Path) -> Path:
    """Write a case's dataset, by the beginning of its name ("12-"), and return its folder."""
    (script,) = sorted(folder("cases").glob(f"{name}*/make.py"))
    made = out / script.parent.name
    command = [sys.executable, "-B", str(script), str(made)]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return made


def make_layout(name: str, out: Path) -> Path:
    """Write the fake of a public layout, and return its folder."""
    make: Callable[[Path], None] = getattr(_layouts(), name)
    make(out / name)
    return out / name


def layout_scene(seed: int) -> tuple[Any, Any, Any]:
    """Return a frame's truth: rgb, depth in metres (0 = none), Cityscapes' label ids."""
    scene: Callable[[int], tuple[Any, Any, Any]] = _layouts().scene
    return scene(seed)


def case_scene(seed: int, height: int = 96, width: int = 128, **more: float) -> Any:
    """Return what the cases render, its truth: rgb, depth in metres, label."""
    return _module(folder("cases") / "scene.py").scene(seed, h=height, w=width, **more)


def _layouts() -> Any:
    return _module(folder("layouts") / "make_layouts.py")


def _module(script: Path) -> Any:
    spec = importlib.util.spec_from_file_location(script.stem, script)
    assert spec is not None
    assert spec.loader is not None
    module: Any = importlib.util.module_from_spec(spec)
    # Nothing is written beside it.
    before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        spec.loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = before
    return module


def nimprep_run(*arguments: object) -> Result:
    """Run a command as the command line does."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])
