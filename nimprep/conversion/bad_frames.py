"""What is said of a bad frame that ends a conversion: how to go on without it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from nimprep.conversion.options import RunOptions
from nimprep.errors import NimprepError

WAY_OUT = "--on-error skip leaves such frames out"


@contextmanager
def way_out_said(options: RunOptions) -> Iterator[None]:
    """Add to an error that is a frame's how such frames are left out."""
    try:
        yield
    except NimprepError as error:
        if error.frame_id is not None and options.on_error == "stop":
            error.add_note(WAY_OUT)
        raise
