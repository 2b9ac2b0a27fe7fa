"""The public layouts, written once."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def layout_maker(reference_data: Path) -> ModuleType:
    """The script that writes tiny fakes of public layouts; CI requires it."""
    script = reference_data.parent / "layouts" / "make_layouts.py"
    if not script.is_file():
        reason = f"no layouts at {script}; they lie beside NIMPREP_REFERENCE_DATA"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    spec = importlib.util.spec_from_file_location("make_layouts", script)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no dataset be known by name: what inspect says of a folder is told by its files."""
    monkeypatch.setattr("nimprep.inspection.inspection.fitting_reader", lambda root, notes: None)
    monkeypatch.setattr("nimprep.inspection.inspection.meant_instead", lambda root: None)


@pytest.fixture(scope="session")
def layout(
    layout_maker: ModuleType, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], Path]:
    """Return a layout's folder by name, written at the first request."""
    home = tmp_path_factory.mktemp("layouts")

    def written(name: str) -> Path:
        folder = home / name / "raw"
        if not folder.exists():
            getattr(layout_maker, name)(folder)
        return folder

    return written
