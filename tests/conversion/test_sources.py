"""A frame's digest is of its files' contents; a large file of many frames is read once for them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from nimprep.conversion import sources
from nimprep.readers import open_reader
from tests.fakes import write_gmrp


def test_a_large_file_is_read_once_and_anew_when_it_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = open_reader(write_gmrp(tmp_path / "gmrp", frames=2))
    small = [sources.frame_digest(reader, i) for i in reader.ids]
    monkeypatch.setattr(sources, "LARGE_FILE", 1)
    before = sources._large_digest.cache_info()
    files = {path for i in reader.ids for path in reader.sources(i)}
    for _ in range(3):
        assert [sources.frame_digest(reader, i) for i in reader.ids] == small
    after = sources._large_digest.cache_info()
    assert after.misses - before.misses == len(files)
    changed = reader.sources(reader.ids[0])[0]
    changed.write_bytes(changed.read_bytes() + b"x")
    os.utime(changed, ns=(1, 1))
    found = [sources.frame_digest(reader, i) for i in reader.ids]
    assert found[0] != small[0]
    assert found[1] == small[1]
