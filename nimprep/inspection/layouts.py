"""Which reader's layout a folder has, itself, above or within."""

from __future__ import annotations

from pathlib import Path

from nimprep.errors import NimprepError
from nimprep.readers import READERS, ReaderName, ReaderOptions, open_reader


def fitting_reader(root: Path) -> tuple[ReaderName, int] | None:
    """Return the reader that opens a folder as it is, and its number of frames; None = none.

    A reader's folders alone do not tell: TUM's rgb/ is GMRP's too.
    """
    for name, layout in READERS.items():
        if not any((root / mark).is_dir() for mark in layout.marks):
            continue
        for labels in (True, False):
            try:
                reader = open_reader(root, ReaderOptions(reader=name), labels=labels)
                if reader.ids:
                    reader.shape(reader.ids[0])
                    return name, len(reader.ids)
            except NimprepError:
                continue
    return None
