"""nimprep append."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from nimprep.cli.echo import echo
from nimprep.cli.options import options_from, options_given, progress_bars, report_skipped
from nimprep.conversion.options import AppendOptions


@click.command()
@click.argument("src", type=click.Path(path_type=Path))
@click.argument("store")
@options_from(AppendOptions)
def append(src: Path, store: str, quiet: bool, allow_skipped: int, **given: Any) -> None:
    """Add the frames of the raw dataset SRC to STORE.

    What is made of them, the store says: modalities, recipe, codec, crop. How SRC is read is to be
    said again as it was for the store. Frames in the store keep their split; new ones get theirs
    by its rule and seed. At every moment STORE is the old one or the new one, whole; an append
    that was cut short goes on where it stopped when the same command is given again.
    """
    options = options_given(AppendOptions, given)
    import nimprep
    from nimprep.store.info import info_text, store_info

    done = nimprep.append_frames(src, store, options, progress=progress_bars(quiet))
    there = f", {done.existing} were there already" if done.existing else ""
    echo(f"added {len(done.ids)} frames{there}")
    echo()
    echo(info_text(store_info(store)), lines=True)
    report_skipped(store, [asdict(frame) for frame in done.skipped], allow_skipped)
