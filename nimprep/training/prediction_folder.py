"""A folder of predictions: new, or in the place of predictions that were there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from nimprep.errors import LayoutError
from nimprep.evaluation.predictions import ABOUT
from nimprep.folders import hidden_name, place_of, refuse_inside, refuse_within, told, whole_folder
from nimprep.networks.checkpoint import BEST
from nimprep.store.swap import swap_folders


def default_folder(run: Path, split: str) -> Path:
    """Return where a run's predictions go that are given no place: beside its folder."""
    place = Path(os.path.realpath(run))
    folder = place.parent if place.name == BEST else place
    shown = run.parent if run.name == BEST else run
    if shown.name in ("", ".", ".."):
        return folder.with_name(f"{folder.name}-{split}")
    return shown.with_name(f"{shown.name}-{split}")


@contextmanager
def predictions_folder(out: Path, *sources: Path, overwrite: bool) -> Iterator[Path]:
    """Give a hidden folder to fill; it is at `out` when the context ends well, as a whole.

    Parameters
    ----------
    overwrite : bool
        Predictions may be there: they stay until then.

    Raises
    ------
    LayoutError
        `out` is neither new nor empty nor, to be replaced, a folder of predictions; it lies in a
        source or a store; or it cannot be written.
    """
    if not (overwrite and (out / ABOUT).is_file() and not out.is_symlink()):
        with whole_folder(out, *sources) as partial:
            yield partial
        return
    with told(out, LayoutError):
        refuse_inside(out, *sources)
        refuse_within(out)
    place = place_of(out)
    new, old = (place.with_name(hidden_name()) for _ in range(2))
    try:
        with whole_folder(new, *sources) as partial:
            yield partial
        with told(out, LayoutError):
            if not swap_folders(new, place):
                place.rename(old)
                new.rename(place)
    finally:
        for path in (new, old):
            shutil.rmtree(path, ignore_errors=True)
